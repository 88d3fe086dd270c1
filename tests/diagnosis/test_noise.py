"""The noise is measured in holds, repeats and second recordings, never in the residual of a fit."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.diagnosis.plants import FS_HZ, creep, multisine, record, stairs, triangles
from tests.diagnosis.prepared import prepared
from torchpi.diagnosis.converter import converter
from torchpi.diagnosis.noise import Noise, held_error, holds, is_white, measured_noise
from torchpi.diagnosis.records import prepare
from torchpi.recordings.recording import Recording
from torchpi.stage.effects.sensor.quantization import Codes

Signal = np.ndarray


def measured(*recordings: Recording) -> Noise:
    found = measured_noise(prepared(recordings))
    assert found is not None
    return found


def white(samples: int, seed: int = 0) -> Signal:
    return np.random.default_rng(seed).standard_normal(samples)


def flicker(samples: int, seed: int = 0) -> Signal:
    """Noise of power 1/f, of unit variance."""
    f = np.fft.rfftfreq(samples)
    f[0] = f[1]
    e = np.fft.irfft(np.fft.rfft(white(samples, seed)) / np.sqrt(f), samples)
    return e / e.std()


def read(u: Signal, e: Signal, name: str = "a") -> Recording:
    """Record a linear stage with this noise."""
    return Recording(name, np.arange(len(u)) / FS_HZ, u, 0.8 * u + e, FS_HZ)


@pytest.mark.parametrize("noise_um", [4e-4, 4e-3, 0.05])
def test_the_noise_of_stairs_is_measured_in_their_holds_even_if_the_stage_creeps(noise_um: float) -> None:
    found = measured(record(stairs(8000), after=lambda x, fs_hz: creep(x, fs_hz, 0.02), noise_um=noise_um))
    assert found.rms_um == pytest.approx(noise_um, rel=0.05) and found.source.startswith("holds")


def test_a_hold_reading_affected_by_the_next_step_is_not_taken_for_noise() -> None:
    u = stairs(8000)
    late = read(u, 0.01 * white(8000))
    late.y[:-1] += 0.4 * np.diff(u)
    assert measured(late).rms_um == pytest.approx(0.01, rel=0.1)


def test_holds_are_found_in_a_noisy_monitored_voltage() -> None:
    u = stairs(8000)
    noisy = u + 2e-3 * white(8000, 5)
    found = measured(read(noisy, 0.01 * white(8000) - 0.8 * (noisy - u)))
    assert found.rms_um == pytest.approx(0.01, rel=0.1) and found.source.startswith("holds")


def test_moving_voltages_with_noise_are_not_holds() -> None:
    t = np.arange(8000) / 8000
    for u in (10 * t, 5 - 5 * np.cos(2 * np.pi * t), multisine(8000), triangles(8000)):
        assert holds(u + 1e-3 * white(8000)) == []


def test_the_noise_is_unknown_if_nothing_holds_or_repeats() -> None:
    assert measured_noise(prepared([record(multisine(4000))])) is None
    assert measured_noise(prepared([record(multisine(4000)), record(triangles(4000), name="b")])) is None


def test_three_periods_measure_the_noise_and_two_do_not() -> None:
    once = multisine(2000)
    assert measured_noise(prepared([record(np.tile(once, 2), noise_um=0.02)])) is None
    found = measured(record(np.tile(once, 3), noise_um=0.02))
    assert found.rms_um == pytest.approx(0.02, rel=0.1) and found.source.startswith("repeated periods")


def test_the_transient_of_the_first_period_is_not_taken_for_noise() -> None:
    u = np.tile(multisine(2000), 4)
    start = 1.0 * np.exp(-np.arange(len(u)) / 200)
    assert measured(read(u, start + 0.02 * white(len(u)))).rms_um == pytest.approx(0.02, rel=0.1)


def test_a_drift_from_period_to_period_is_not_taken_for_noise() -> None:
    u = np.tile(multisine(2000), 4)
    drift = 0.5 * np.arange(8000) / 8000
    assert measured(read(u, drift + 0.02 * white(8000))).rms_um == pytest.approx(0.02, rel=0.1)


def test_a_measured_input_counts_as_periodic_despite_its_noise() -> None:
    one = record(np.tile(multisine(2000), 4), noise_um=0.02)
    noisy = replace(one, u=one.u + 1e-4 * white(len(one.u), 5))
    assert measured(noisy).rms_um == pytest.approx(0.02, rel=0.1)


def test_a_second_recording_of_the_same_voltage_measures_the_noise() -> None:
    u = multisine(4000)
    found = measured(*(record(u, noise_um=0.02, seed=s, name=str(s)) for s in (1, 2)))
    assert found.rms_um == pytest.approx(0.02, rel=0.1) and found.source.startswith("recordings")


def test_a_hold_in_one_recording_gives_the_noise_of_all() -> None:
    moving, resting = record(multisine(4000)), record(np.zeros(2000), noise_um=0.01, name="rest")
    assert measured(moving, resting).rms_um == pytest.approx(0.01, rel=0.1)


def test_the_noise_is_measured_in_the_residuals_of_a_simulation_if_given() -> None:
    records = prepared([record(stairs(8000), noise_um=0.02)])
    found = measured_noise(records, [0.005 * white(8000, 1)])
    assert found is not None and found.rms_um == pytest.approx(0.005, rel=0.05)


@pytest.mark.parametrize(("noise", "slope"), [(white, 0.0), (flicker, 1.0)], ids=["white", "1/f"])
def test_the_noise_of_each_scale_follows_the_colour_of_the_noise(
    noise: Callable[[int, int], Signal], slope: float
) -> None:
    u = np.tile(multisine(4096), 6)
    found = [measured(read(u, 0.01 * noise(len(u), seed))) for seed in range(6)]
    levels = np.array([[one.level_um2(level) for level in range(1, 8)] for one in found]).mean(0)
    fitted = np.polyfit(np.arange(7), np.log2(levels), 1)[0]
    assert fitted == pytest.approx(slope, abs=0.15)
    if slope == 0.0:
        assert levels == pytest.approx(np.full(7, 1e-4), rel=0.2)


def test_the_noise_of_slower_scales_is_extrapolated_if_it_rises() -> None:
    found = Noise(1.0, 2.0 ** np.arange(6), 1e3, "periods")
    assert found.level_um2(6) == 32.0
    assert found.level_um2(8) == pytest.approx(128.0)
    falling = Noise(1.0, 2.0 ** -np.arange(6), 1e3, "periods")
    assert falling.level_um2(9) == falling.level_um2(6)  # falling noise would extrapolate to zero


def test_mains_hum_in_a_hold_is_not_taken_for_noise() -> None:
    t = np.arange(8000) / FS_HZ
    e = 0.01 * white(8000) + 0.02 * np.sin(2 * np.pi * 50.02 * t)
    assert measured(read(stairs(8000, 2), e)).rms_um == pytest.approx(0.01, rel=0.1)


def test_quantisation_is_part_of_the_noise() -> None:
    """A hold may stay on one level, so the noise is then the uniform error of one step."""
    found = Noise(0.0, np.zeros(3), FS_HZ, "holds of the voltage").with_converter(0.0123)
    assert found.rms_um == pytest.approx(0.0123 / np.sqrt(12))
    assert found.variance_um2 == pytest.approx(np.full(3, 0.0123**2 / 12))


def test_wrong_readings_are_not_taken_for_noise() -> None:
    """A flipped bit in a hold is a thousand times larger than the noise and not part of it."""
    y = 0.01 * white(4000)
    flipped = y.copy()
    flipped[[1200, 2500]] += 9.0
    recordings = [read(np.zeros(4000), flipped)]
    found = measured_noise(prepare(recordings, [np.array([1200, 2500])]))
    assert found is not None and found.rms_um == pytest.approx(0.01, rel=0.1)


def test_constant_readings_yield_no_noise_measurement() -> None:
    still = read(np.zeros(2000), np.zeros(2000))
    assert measured_noise(prepared([still])) is None


def read_by(lsb_um: float, one: Recording) -> Recording:
    return replace(one, y=lsb_um * np.floor(one.y / lsb_um + 0.5))


@pytest.mark.parametrize("noise_um", [0.0, 2e-3, 0.03])
def test_the_converter_step_is_found_from_the_readings(noise_um: float) -> None:
    recordings = [
        read_by(0.0123, record(multisine(3000, seed=s), noise_um=noise_um, name=str(s))) for s in (0, 1)
    ]
    codes, notes = converter(recordings)
    assert codes.step_um == pytest.approx(0.0123, rel=1e-6)
    assert notes == ("All readings lie on a grid with a step of 12.3 nm.",)


def test_one_converter_step_is_found_even_if_one_recording_has_few_distinct_values() -> None:
    stair = record(np.repeat([1.0, 4.0, 7.0, 3.0], 750), noise_um=0.0, name="stair")
    recordings = [read_by(0.2, one) for one in (stair, record(multisine(3000)))]
    assert len(np.unique(recordings[0].y)) < 8
    assert converter(recordings)[0].step_um == pytest.approx(0.2, rel=1e-6)


@pytest.mark.parametrize("other", [multisine(3000, seed=1), np.repeat([1.0, 4.0, 7.0, 3.0], 750)])
def test_uneven_converter_codes_are_found_as_well(other: np.ndarray) -> None:
    """A staircase reaches only a few of them."""
    places = 0.2 * np.random.default_rng(0).uniform(0.75, 1.25, 120).cumsum() - 4.0
    recordings = []
    for name, u in (("a", multisine(3000)), ("b", other)):
        one = record(u, noise_um=0.03, name=name)
        y = places[np.abs(one.y[:, None] - places).argmin(1)]
        recordings.append(replace(one, y=y))
    codes, (note,) = converter(recordings)
    assert codes.step_um == pytest.approx(0.2, rel=0.25)
    assert 0.01 * codes.step_um < codes.half_width_um < 0.1 * codes.step_um
    assert "unevenly" in note


def test_readings_without_a_grid_have_no_converter_step() -> None:
    assert converter([record(multisine(3000))]) == (Codes(0.0, 0.0), ())


def test_one_recording_off_the_grid_rules_out_a_converter_step() -> None:
    recordings = [read_by(0.0123, record(multisine(3000))), record(multisine(3000, seed=1), name="b")]
    assert converter(recordings) == (Codes(0.0, 0.0), ())


def test_the_quantisation_error_factor_reaches_the_number_of_readings_held_on_one_level() -> None:
    samples, run = 16384, 64
    still, moving = np.repeat(np.arange(samples // run) % 7, run), np.arange(samples) % 5
    for y, most in ((still, run), (moving, 1)):
        (one,) = prepared([read(np.linspace(0, 9, samples), y.astype(float))])
        times = held_error(y.astype(float), one.coefficients)
        assert times.min() >= 1.0 and times.max() == pytest.approx(most, rel=0.01)


def test_the_predicted_quantisation_error_matches_the_actual_one_on_slow_scales() -> None:
    samples, lsb = 8192, 1.0
    rng = np.random.default_rng(4)
    true = np.repeat(rng.uniform(0, 50, 90), rng.integers(70, 120, 90))[:samples]
    e = np.round(true / lsb) * lsb - true
    (one,) = prepared([read(np.linspace(0, 9, samples), e)])
    of = one.coefficients
    times = held_error(np.round(true / lsb), of)
    measured_um2 = np.bincount(of.cell, of(e[None])[0] ** 2) / np.bincount(of.cell)
    level = of.level_of_cell
    assert len(true) == samples
    for k in range(6, level.max() + 1):
        mean_times = times[level == k].mean()
        assert 0.3 < measured_um2[level == k].mean() / (lsb**2 / 12 * mean_times) < 3.0


def test_the_converter_step_is_found_from_raw_and_not_from_interpolated_readings() -> None:
    one = read_by(0.0123, record(multisine(3000), noise_um=0.002))
    share = np.random.default_rng(0).uniform(size=len(one.y) - 1)
    between = share * one.y[:-1] + (1 - share) * one.y[1:]
    interpolated = replace(one, t=one.t[1:], u=one.u[1:], y=between)
    assert converter([interpolated]) == (Codes(0.0, 0.0), ())
    assert converter([replace(interpolated, as_read=one.y)])[0].step_um == pytest.approx(0.0123, rel=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_coloured_noise_counts_as_noise_and_a_random_walk_between_periods_does_not(seed: int) -> None:
    rng, n, periods = np.random.default_rng(seed), 2048, 12
    u = np.tile(np.sin(2 * np.pi * np.arange(n) / n), periods)
    white = rng.normal(size=len(u))
    f = np.fft.rfftfreq(len(u))
    pink = np.fft.irfft(np.fft.rfft(white) / np.sqrt(np.maximum(f, 1 / len(u)) / 0.1), len(u))
    low_passed = np.fft.irfft(np.fft.rfft(white) / (1 + 2j * np.pi * f / 0.2), len(u))
    walk = 0.4 * rng.normal(size=len(u)).cumsum()
    for noise, rms in ((pink, pink.std()), (low_passed, low_passed.std()), (white + walk, 1.0)):
        found = measured_noise(prepared([read(u, 0.01 * noise)]))
        assert found is not None and found.rms_um == pytest.approx(0.01 * rms, rel=0.5)


def test_a_residual_is_white_unless_samples_a_few_apart_correlate_about_their_mean() -> None:
    white = np.random.default_rng(0).standard_normal(4000)
    assert is_white(white) and is_white(white + 5.0) and is_white(np.zeros(100))
    assert not is_white(white[1:] + 0.9 * white[:-1]) and not is_white(white[1:] - 0.9 * white[:-1])
    assert is_white(white[1:] + 0.3 * white[:-1])  # 0.3 / (1 + 0.09) = 0.28
    assert not is_white(white[1:] + 0.4 * white[:-1])  # 0.34
    ring = np.sin(np.pi / 2 * np.arange(4000))  # neighbouring samples do not correlate
    assert not is_white(white + ring) and is_white(white + 0.5 * ring)


@given(st.integers(400, 3000), st.integers(0, 100))
def test_white_noise_is_white(samples: int, seed: int) -> None:
    assert is_white(np.random.default_rng(seed).standard_normal(samples))
