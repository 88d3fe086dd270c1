"""A monitored voltage: its noise is removed, and the underlying command stays."""

from dataclasses import replace

import numpy as np
import pytest

from tests.diagnosis.plants import NOISE_UM, multisine, record, triangles
from tests.diagnosis.prepared import prepared
from torchpi.diagnosis.diagnose import diagnose
from torchpi.diagnosis.monitored import monitor_noise, without_noise
from torchpi.diagnosis.noise import Noise
from torchpi.diagnosis.score import Weighting
from torchpi.operators.hysteresis_rows import bouc_wen_row

T = np.arange(20_000) / 1e3
RNG = np.random.default_rng(0)
COMMANDS = {
    "sine": 50 + 50 * np.sin(2 * np.pi * T),
    "triangles": 100 * np.abs(T % 1 * 2 - 1),
    "stairs": np.floor(2 * T) % 7 * 10.0,
    "walk": np.cumsum(RNG.normal(0, 0.05, len(T))),
    "telegraph": 10.0 * (RNG.random(len(T)) > 0.5),
    "rest": np.full(len(T), 3.0),
}
SD = 0.02


def monitored(u: np.ndarray, seed: int = 1, sd: float = SD) -> np.ndarray:
    return u + np.random.default_rng(seed).normal(0, sd, len(u))


def random_between_holds() -> np.ndarray:
    """Return a random voltage of 10 V rms between two holds of 300 samples."""
    u = np.random.default_rng(4).normal(0, 10.0, 6000)
    u[:300], u[-300:] = 0.0, 5.0
    return u


@pytest.mark.parametrize("name", COMMANDS)
def test_a_noise_free_command_stays_unchanged(name: str) -> None:
    u = COMMANDS[name]
    assert monitor_noise([u]) == [0.0] and without_noise(u, 0.0)[0] is u


@pytest.mark.parametrize("name", ["sine", "triangles", "stairs"])
def test_noise_is_removed_and_corners_stay(name: str) -> None:
    u = COMMANDS[name]
    seen = monitored(u)
    (sd,) = monitor_noise([seen])
    left = without_noise(seen, sd)[0] - u
    assert sd == pytest.approx(SD, rel=0.05)
    assert left.std() < 0.4 * SD and np.abs(left).max() < 8 * SD


def test_noise_is_measured_between_frequent_steps() -> None:
    u = np.repeat(np.random.default_rng(7).uniform(0, 100, 40), 60)
    assert monitor_noise([monitored(u)])[0] == pytest.approx(SD, rel=0.15)


def test_noise_of_a_random_voltage_is_measured_and_removed_in_its_holds() -> None:
    u = random_between_holds()
    seen = monitored(u)
    (sd,) = monitor_noise([seen])
    left = without_noise(seen, sd)[0] - u
    assert sd == pytest.approx(SD, rel=0.15)
    assert left[:300].std() < 0.4 * SD
    np.testing.assert_allclose(left[300:-300], seen[300:-300] - u[300:-300], atol=8 * SD)


def test_recordings_share_the_noise_of_one_monitor_unless_one_is_clearly_quieter() -> None:
    """A recording that never rests takes the noise of the others; a clearly quieter one keeps its own."""
    never_rests = np.random.default_rng(4).normal(0, 10.0, 6000)
    slow = COMMANDS["sine"]
    both = monitor_noise([monitored(slow), monitored(never_rests)])
    assert both[0] == both[1] == pytest.approx(SD, rel=0.05)
    assert monitor_noise([monitored(slow), slow, never_rests])[1] == 0.0
    quieter = monitor_noise([monitored(slow), monitored(slow, sd=0.1 * SD)])
    assert quieter == pytest.approx([SD, 0.1 * SD], rel=0.05)
    alike = monitor_noise([monitored(slow), monitored(slow, sd=1.4 * SD), monitored(slow, seed=2)])
    assert alike == [alike[0]] * 3 == pytest.approx([SD] * 3, rel=0.05)


def test_a_voltage_that_scatters_as_much_as_it_moves_is_taken_as_a_command() -> None:
    u = np.random.default_rng(2).normal(0, 1, 5000)
    assert monitor_noise([u]) == [0.0]


def test_the_rounding_of_a_file_is_not_taken_for_noise() -> None:
    assert monitor_noise([np.round(COMMANDS["sine"], 6)]) == [0.0]


def test_no_noise_is_assumed_in_a_record_too_short_to_tell() -> None:
    assert monitor_noise([monitored(COMMANDS["sine"][:200], 3)]) == [0.0]


def test_smoothing_keeps_a_bouc_wen_state_from_drifting_in_a_noisy_hold() -> None:
    """A Bouc–Wen state moves with every reversal of the voltage, including those of noise."""
    u = random_between_holds()
    u[-3000:] = 5.0
    seen = monitored(u)
    smooth, _ = without_noise(seen, *monitor_noise([seen]))
    true, raw, found = (bouc_wen_row(v, 5.0, 0.8, 1.0, 0.0)[-1] for v in (u, seen, smooth))
    assert abs(found - true) < 0.1 * abs(raw - true)


def test_the_remaining_noise_is_known_for_every_sample() -> None:
    u = random_between_holds()
    seen = monitored(u)
    smooth, left = without_noise(seen, SD)
    error = smooth - u
    assert (left[400:-400] == SD).mean() > 0.9 and left[50:250].max() < 0.4 * SD
    assert error[left == SD].std() == pytest.approx(SD, rel=0.1)


@pytest.mark.parametrize("high_hz", [100.0, 200.0, 400.0])
def test_the_error_of_a_smoothed_fast_voltage_is_as_stated_and_below_the_noise(high_hz: float) -> None:
    """A long window would err by as much as the noise, yet claim a smaller error."""
    u = multisine(20_000, high_hz=high_hz)
    smooth, left = without_noise(monitored(u, sd=0.01), 0.01)
    assert (smooth - u).std() == pytest.approx(np.sqrt((left**2).mean()), rel=0.25)
    assert (smooth - u).std() < 0.01


@pytest.mark.parametrize("samples", [260, 600, 1200])
def test_a_short_record_is_smoothed_too(samples: int) -> None:
    u = COMMANDS["sine"][:samples]
    smooth, _ = without_noise(monitored(u), SD)
    assert (smooth - u).std() < 0.5 * SD


def test_the_effect_of_monitor_noise_on_the_prediction_counts_as_noise() -> None:
    random, slow = random_between_holds(), COMMANDS["sine"][:6000]
    records = prepared([record(monitored(random)), record(monitored(slow), name="b")])
    only_read = Noise(0.001, np.full(12, 1e-6), records[0].fs_hz, "holds of the voltage")
    noise = only_read.with_monitor(records, 0.5)
    assert noise.rms_um == pytest.approx(0.5 * SD / np.sqrt(2), rel=0.1)
    floors = Weighting.of(records, [one.y for one in records], noise).floor_um2
    fast = floors[: records[0].coefficients.cell.max() + 1]
    assert np.median(fast) == pytest.approx((0.5 * SD) ** 2, rel=0.2)
    assert np.median(floors[len(fast) :]) < 0.2 * np.median(fast)


def test_a_noise_free_command_adds_nothing_to_the_noise() -> None:
    records = prepared([record(COMMANDS["sine"][:6000])])
    noise = Noise(0.001, np.full(12, 1e-6), records[0].fs_hz, "holds of the voltage")
    assert noise.with_monitor(records, 0.5) is noise


def test_noise_of_a_monitored_voltage_is_not_mistaken_for_a_lag() -> None:
    """Any filter that suppresses this noise improves the prediction."""
    commanded = [
        record(multisine(6000, high_hz=20.0), seed=1),
        record(triangles(6000), name="b", seed=2),
    ]
    rng = np.random.default_rng(5)
    found = diagnose([replace(one, u=one.u + rng.normal(0, 0.006, len(one.u))) for one in commanded])
    assert found.effects == ()
    assert found.augmented.heldout_rms_um < 1.5 * NOISE_UM
    assert any("measured voltage contains noise" in note for note in found.notes)
