"""What counts as a gain or a zero that wanders, and what does not."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.diagnosis.plants import pair, record
from torchpi.diagnosis.decide import Decision
from torchpi.diagnosis.diagnose import diagnose
from torchpi.diagnosis.diagnosis import NamedEffect
from torchpi.diagnosis.repeats import Repeats
from torchpi.diagnosis.walks import CELLS
from torchpi.diagnosis.wandering import (
    of_the_whole,
    of_what_does_not_repeat,
    wandering,
    with_wandering,
)
from torchpi.stage.effects.sensor.gain_modulation import GainModulation
from torchpi.stage.effects.sensor.thermal_drift import ThermalDrift

TIME, NOISE_UM = 2000, 0.01
GAIN = 0.01
"""Rms of a walk of the gain."""

Residual = Callable[[np.ndarray, np.random.Generator], np.ndarray]


def motions() -> list[np.ndarray]:
    """(time,), µm: a chirp, and steps of random size."""
    t = np.arange(TIME) / TIME
    steps = np.random.default_rng(1).uniform(0, 10, 40).repeat(TIME // 40)
    return [5 - 5 * np.cos(2 * np.pi * (2 * t + 20 * t**2)), lfilter([0.3], [1, -0.7], steps)]


def repeating() -> list[np.ndarray]:
    """(time,), µm: two periods of a motion, and five of another."""
    halves, fifths = motions()[0][: TIME // 2], motions()[1][: TIME // 5]
    return [np.tile(halves, 2), np.tile(fifths, 5)]


def walk(rng: np.random.Generator) -> np.ndarray:
    """(time,): a random walk that tends back to 0 within 100 samples, of rms 1, without its mean."""
    found = lfilter([1], [1, -0.99], rng.normal(size=TIME))
    return (found - found.mean()) / found.std()


def left(
    of: Residual, moving: Callable[[], list[np.ndarray]] = motions
) -> tuple[list[SimpleNamespace], SimpleNamespace]:
    """Return recordings, and a fit that leaves this function of their motion and noise."""
    rng = np.random.default_rng(2)
    residuals = [of(x, rng) + rng.normal(0, NOISE_UM, TIME) for x in moving()]
    counts = np.ones(TIME, dtype=bool)
    records = [
        SimpleNamespace(
            y=x + e,
            aux={},
            train=counts,
            held_out=~counts,
            period_s=1e-3,
            coefficients=SimpleNamespace(repeats=Repeats.of(x, TIME, counts)),
        )
        for x, e in zip(moving(), residuals, strict=True)
    ]
    return records, SimpleNamespace(residuals=residuals)


def of_a_gain(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return GAIN * walk(rng) * x


def of_a_gain_that_never_returns(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """It is so slow that the motion seems to predict a part of it, as of any slow signal."""
    found = np.cumsum(rng.normal(size=TIME))
    return GAIN * (found - found.mean()) / found.std() * x


def of_a_line_that_sweeps(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    t = np.arange(TIME) / TIME
    return GAIN * np.sqrt(2) * np.sin(2 * np.pi * (2 * t + 4 * t**2) + rng.uniform(0, 6)) * x


def of_an_added_walk(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return 0.05 * walk(rng)


def of_a_gain_that_ages(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return GAIN * np.linspace(-1, 1, TIME) * x


def of_a_gain_that_follows_the_motion(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return GAIN * (x - x.mean()) * x


def of_a_mode(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return lfilter([0.05], [1, -1.8, 0.95], np.gradient(np.gradient(x)))


def of_a_lag(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return lfilter([0.5], [1, -0.5], x) - x


def of_a_lag_that_depends_on_the_position(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return of_a_lag(x, rng) * x / 10


def of_a_burst(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A gain that moves for an eighth of the time."""
    return 10 * GAIN * walk(rng) * x * (np.abs(np.arange(TIME) / TIME - 0.4) < 1 / 16)


def of_a_gain_within_the_noise(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return 0.15 * of_a_gain(x, rng)


def of_noise(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.zeros(TIME)


@pytest.mark.parametrize(("moving", "alike"), [(motions, 0.9), (repeating, 0.6)])
@pytest.mark.parametrize("of", [of_a_gain, of_a_gain_that_never_returns, of_a_line_that_sweeps])
def test_a_gain_of_any_course_is_found_with_its_size_and_what_it_adds(
    of: Residual, moving: Callable[[], list[np.ndarray]], alike: float
) -> None:
    """What two periods have in common is not seen, which is half of a walk's power."""
    records, fit = left(of, moving)
    found = wandering(records, fit, NOISE_UM)
    assert found is not None and found.effect is GainModulation and not found.alternatives
    assert found.probability > 0.9
    assert found.share > 0.4
    assert found.rms == pytest.approx(GAIN, rel=0.4)
    known = slice(TIME // CELLS, None)  # the first stretch only determines the constants
    for added, e in zip(found.adds, fit.residuals, strict=True):
        assert np.corrcoef(added[known], e[known])[0, 1] > alike


def of_a_zero(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A walk that never returns, beside four times as much that repeats."""
    found = np.cumsum(rng.normal(size=TIME))
    return 0.1 * (found - found.mean()) / found.std() + 0.4 * np.sin(3 * x)


@pytest.mark.parametrize("noise_um", [NOISE_UM, 0.0])
def test_a_zero_that_wanders_is_found_beneath_what_repeats_with_the_voltage(noise_um: float) -> None:
    records, fit = left(of_a_zero, repeating)
    found = wandering(records, fit, noise_um)
    assert found is not None and found.effect is ThermalDrift and not found.alternatives
    assert found.probability > 0.9
    assert found.share == pytest.approx(0.01 / 0.09, rel=0.3)
    for added, e, x in zip(found.adds, fit.residuals, repeating(), strict=True):
        wanders = e - 0.4 * np.sin(3 * x)
        assert np.corrcoef(added[100:], wanders[100:])[0, 1] > 0.8


@pytest.mark.parametrize("follows", [True, False])
def test_a_zero_that_follows_another_recorded_signal_does_not_wander(follows: bool) -> None:
    records, fit = left(of_noise, repeating)
    rng = np.random.default_rng(6)
    for one, e in zip(records, fit.residuals, strict=True):
        other = walk(rng)
        e += 0.1 * other**2 + 0.01 * one.y * other
        one.y += 0.1 * other**2 + 0.01 * one.y * other
        one.aux = {"aux_v": other if follows else walk(rng), "unplugged": np.zeros(TIME)}
    assert (wandering(records, fit, NOISE_UM) is None) == follows


def test_it_is_not_looked_for_where_the_voltage_does_not_repeat() -> None:
    assert wandering(*left(of_a_zero), NOISE_UM) is None


def of_a_zero_beside_little_motion(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return 0.1 * walk(rng)


def test_what_a_gain_adds_to_a_nearly_constant_displacement_may_be_a_zero_as_well() -> None:
    records, fit = left(of_a_zero_beside_little_motion, lambda: [10 + 0.2 * x for x in repeating()])
    found = wandering(records, fit, NOISE_UM)
    assert found is not None
    assert {found.effect.name, *found.alternatives} == {"gain_modulation", "thermal_drift"}
    noise = SimpleNamespace(rms_um=NOISE_UM)
    before = Decision("unexplained", (), (), 0.1, 0.0, NOISE_UM)
    named, _ = with_wandering(before, records, fit, fit, noise)
    assert named.effects[0].alternatives == found.alternatives
    either = replace(before, effects=(replace(found.named, name=found.alternatives[0]),))
    assert with_wandering(either, records, fit, fit, None) == (either, None)


def of_a_sway(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return 0.1 * np.sin(2 * np.pi * 5.3 * np.arange(TIME) / TIME)


def test_a_zero_that_sways_at_one_frequency_may_be_a_modulation() -> None:
    found = wandering(*left(of_a_sway, repeating), NOISE_UM)
    assert found is not None and found.effect is ThermalDrift
    assert found.alternatives == ("gain_modulation",)


def of_a_zero_that_ages(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    age = np.linspace(0, 1, TIME)
    return 0.1 * age - 0.1 * np.log(0.01 + age)


def of_a_zero_that_jumps(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Between two values, eleven times."""
    return 0.1 * (np.searchsorted(np.sort(rng.integers(0, TIME, 11)), np.arange(TIME)) % 2)


def of_a_zero_that_wanders_for_a_while(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return 0.1 * walk(rng) * (np.abs(np.arange(TIME) / TIME - 0.4) < 1 / 16)


def of_a_zero_within_the_noise(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return 0.7 * NOISE_UM * walk(rng)


def of_a_zero_that_returns_within_a_few_means(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return lfilter([0.1], [1, -0.92], rng.normal(size=TIME))


OTHERS = [
    of_a_gain_that_ages,
    of_a_gain_that_follows_the_motion,
    of_a_mode,
    of_a_lag,
    of_a_lag_that_depends_on_the_position,
    of_a_burst,
    of_a_gain_within_the_noise,
    of_noise,
    of_a_zero_that_ages,
    of_a_zero_that_returns_within_a_few_means,
    of_a_zero_that_jumps,
    of_a_zero_that_wanders_for_a_while,
    of_a_zero_within_the_noise,
]


@pytest.mark.parametrize("of", [*OTHERS, of_an_added_walk])
@pytest.mark.parametrize("noise_um", [NOISE_UM, 0.0])
def test_no_other_residual_is_a_gain_that_wanders(of: Residual, noise_um: float) -> None:
    records, fit = left(of)
    found = of_the_whole(records, fit.residuals, noise_um)
    assert found is None or found.probability < 0.1


@pytest.mark.parametrize("of", OTHERS)
@pytest.mark.parametrize("noise_um", [NOISE_UM, 0.0])
def test_no_other_residual_wanders_where_the_voltage_repeats(of: Residual, noise_um: float) -> None:
    assert wandering(*left(of, repeating), noise_um) is None


def test_nothing_is_said_where_only_a_little_of_the_voltage_repeats() -> None:
    again = np.tile(5 - 5 * np.cos(np.linspace(0, 2 * np.pi, 90, endpoint=False)), 2)
    moving = np.concatenate([motions()[0][: -len(again)], again])
    records, fit = left(of_a_zero, lambda: [moving])
    assert records[0].coefficients.repeats.apart.any()
    assert of_what_does_not_repeat(records, fit.residuals, NOISE_UM) is None


def test_the_sealed_samples_decide_nothing() -> None:
    records, fit = left(of_noise)
    for one, e in zip(records, fit.residuals, strict=True):
        one.held_out = np.arange(TIME) >= 0.85 * TIME
        one.train = ~one.held_out
        e[one.held_out] += 0.1 * one.y[one.held_out]
        one.y[one.held_out] *= 1.1
    assert wandering(records, fit, NOISE_UM) is None


@pytest.mark.parametrize("measured", [True, False])
def test_it_explains_its_share_but_is_no_complete_explanation(measured: bool) -> None:
    """It leaves a fifth of the mean square of the retuned stage, and a lag explains the rest."""
    records, fit = left(of_a_gain)
    fit.train_rms, retuned = 1.0, SimpleNamespace(train_rms=5**0.5)
    lag = NamedEffect("sensor_lag", "sensor", (), 0.9, (), 0.8 if measured else 1.0, "", "", ())
    before = Decision("partly_explained", (lag,), (), 0.2 if measured else 0.0, 0.0, None)
    noise = SimpleNamespace(rms_um=NOISE_UM) if measured else None
    found, wanders = with_wandering(before, records, retuned, fit, noise)
    assert found.verdict == "partly_explained"
    assert {one.name: one.share for one in found.effects} == pytest.approx(
        {"sensor_lag": 0.8, "gain_modulation": 0.2}, abs=0.03
    )
    assert sum(one.share for one in found.effects) + found.unexplained_share == pytest.approx(1.0)
    assert wanders is not None and len(wanders.adds) == len(records)


@pytest.mark.parametrize("name", ["gain_modulation", "thermal_drift"])
def test_a_diagnosis_names_it_and_shows_what_it_adds(name: str) -> None:
    rng = np.random.default_rng(3)
    if name == "gain_modulation":
        recordings = pair(TIME, after=lambda x, fs_hz: x * (1 + GAIN * walk(rng)))
    else:
        recordings = [
            record(np.tile(u, 2), after=lambda x, fs_hz: x + 0.05 * np.append(walk(rng), walk(rng)))
            for u in repeating()
        ]
    diagnosis = diagnose(recordings)
    assert [effect.name for effect in diagnosis.effects] == [name]
    assert diagnosis.effects[0].form == "random walk"
    for trace in diagnosis.traces:
        left_um = trace.residual_augmented - trace.residual_augmented.mean()
        assert np.corrcoef(trace.signatures[name], left_um)[0, 1] > 0.6


def test_what_is_named_already_or_was_not_to_be_tried_is_not_named() -> None:
    records, fit = left(of_a_gain)
    found = wandering(records, fit, NOISE_UM)
    assert found is not None
    before = Decision("partly_explained", (found.named,), (), 0.1, 0.0, NOISE_UM)
    assert with_wandering(before, records, fit, fit, None) == (before, None)
    none = replace(before, effects=())
    assert with_wandering(none, records, fit, fit, None, [ThermalDrift]) == (none, None)
