"""Maps of the residual: planted errors are located, and noise alone stands out nowhere."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import butter, lfilter, sosfilt

from torchpi.diagnosis.diagnosis import Trace, Where
from torchpi.diagnosis.locate import SIGNIFICANT, locate, normal_score, turning_points

NOISE_UM = 0.004


def record(name: str, u: np.ndarray, e: np.ndarray, fs_hz: float = 10_000.0) -> Trace:
    t = np.arange(len(u)) / fs_hz
    return Trace(name, fs_hz, t, u, 0.8 * u + e, np.zeros(len(u), bool), e, e)


def sine(n: int, hz: float, fs_hz: float = 10_000.0, swing: float = 1.0) -> np.ndarray:
    return swing * (5 - 5 * np.cos(2 * np.pi * hz * np.arange(n) / fs_hz))


def traces(seed: int, n: int = 12_000) -> list[Trace]:
    """White noise over a slow sine, a fast sine, and a growing one at another sample rate."""
    rng = np.random.default_rng(seed)
    growing = sine(n, 4.0, 5_000.0) * np.linspace(0.2, 1, n)
    inputs = (
        ("slow", sine(n, 5.0), 10_000.0),
        ("fast", sine(n, 50.0), 10_000.0),
        ("grows", growing, 5_000.0),
    )
    return [record(name, u, NOISE_UM * rng.standard_normal(n), fs_hz) for name, u, fs_hz in inputs]


def loudest(where: tuple[Where, ...], domain: str, label: str | None = None) -> Where:
    cells = [cell for cell in where if cell.domain == domain and label in (None, cell.label)]
    return max(cells, key=lambda cell: cell.significance)


def test_white_noise_stands_out_in_at_most_four_per_cent_of_diagnoses() -> None:
    scores = [[cell.significance for cell in locate(traces(seed), NOISE_UM)] for seed in range(60)]
    alarms = [max(one) > SIGNIFICANT for one in scores]
    assert np.mean(alarms) <= 0.04
    everything = np.concatenate(scores)
    assert abs(everything.mean()) < 0.15
    assert 0.85 < everything.std() < 1.15
    assert (everything > 3).mean() < 0.006


def test_coloured_noise_is_not_mistaken_for_a_localised_error() -> None:
    """First-order noise with a correlation time of 20 samples stands out in frequency but nowhere else."""
    passed = cells = 0
    for seed in range(20):
        white = np.random.default_rng(seed).standard_normal(60_000)
        e = NOISE_UM * 0.3 * lfilter([1.0], [1.0, -0.95], white)
        where = locate([record("a", sine(60_000, 5.0), e)], NOISE_UM)
        scores = [cell.significance for cell in where if cell.domain != "frequency"]
        passed += sum(score > SIGNIFICANT for score in scores)
        cells += len(scores)
    assert passed <= 0.002 * cells


def test_noise_twice_as_large_in_one_recording_is_located_in_that_recording() -> None:
    found = traces(1)
    found[1] = record("fast", found[1].u, 2 * found[1].residual_retuned)
    where = locate(found, NOISE_UM)
    cell = loudest(where, "recording")
    assert (cell.label, cell.range) == ("fast", (2.0, 2.0))
    assert cell.significance > SIGNIFICANT and cell.share > 0.95


def test_noise_twice_as_large_on_rising_voltage_is_located_there() -> None:
    trace = traces(2)[0]
    e = np.where(np.diff(trace.u, prepend=0) > 0, 2.0, 1.0) * trace.residual_retuned
    where = locate([record("a", trace.u, e)], NOISE_UM)
    cell = loudest(where, "direction")
    assert (cell.label, cell.range) == ("up", (1.0, 1.0))
    assert cell.significance > SIGNIFICANT and cell.share > 0.95
    rising = loudest([one for one in where if one.label in ("rising", "falling")], "rate")
    assert rising.label == "rising" and rising.range[0] >= 0


def test_noise_in_a_frequency_band_is_located_in_that_band() -> None:
    trace = traces(3)[0]
    band = butter(4, (700, 900), "bandpass", fs=10_000.0, output="sos")
    loud_um = 5 * NOISE_UM * sosfilt(band, np.random.default_rng(0).standard_normal(12_000))
    e = trace.residual_retuned + loud_um
    where = locate([record("a", trace.u, e)], NOISE_UM)
    loud = [one for one in where if one.domain == "frequency" and one.significance > SIGNIFICANT]
    assert all(one.range[1] > 500 and one.range[0] < 1200 for one in loud)
    assert sum(one.share for one in loud) > 0.8


def test_a_burst_is_located_in_time() -> None:
    found = traces(4)
    e = found[2].residual_retuned.copy()
    e[7_000:7_300] += 0.03 * np.sin(np.arange(300))
    found[2] = record("grows", found[2].u, e, 5_000.0)
    cell = loudest(locate(found, NOISE_UM), "time", "grows")
    assert cell.unit == "s" and cell.range[0] <= 7_000 / 5_000 < cell.range[1]
    assert cell.significance > SIGNIFICANT


def test_errors_after_reversals_at_large_swings_and_at_large_displacements_are_located() -> None:
    n = 40_000
    u = sine(n, 5.0) * np.repeat([0.3, 1.0], n // 2)
    noise = NOISE_UM * np.random.default_rng(5).standard_normal(n)
    since_s = (np.arange(n) % 1_000) / 10_000
    fresh = locate([record("a", u, noise + 0.02 * (since_s < 0.004))], NOISE_UM)
    assert loudest(fresh, "since_reversal").range[1] <= 0.008
    large = locate([record("a", u, noise * np.where(np.arange(n) < n // 2, 1, 2))], NOISE_UM)
    assert loudest(large, "amplitude").range[1] == pytest.approx(10.0)
    high = locate([record("a", u, noise + 0.02 * (u > 9))], NOISE_UM)
    assert loudest(high, "displacement").range[1] > 0.8 * 9


@given(st.integers(0, 2**31), st.integers(100, 3_000), st.integers(1, 3))
def test_every_map_accounts_for_the_whole_residual(seed: int, n: int, recordings: int) -> None:
    rng = np.random.default_rng(seed)
    drives = (np.cumsum(rng.standard_normal(n)), np.full(n, 3.0), np.floor(np.arange(n) / 50) % 4)
    found = [record(f"r{i}", drives[(seed + i) % 3], rng.standard_normal(n)) for i in range(recordings)]
    where = locate(found, 0.1)
    maps: dict[tuple[str, str], float] = {}
    for cell in where:
        either = cell.domain + (" size" if cell.label == "either way" else "")
        maps[either, cell.unit] = maps.get((either, cell.unit), 0.0) + cell.share
        assert cell.range[0] <= cell.range[1] and 0 <= cell.share <= 1 and np.isfinite(cell.significance)
    assert len(maps) == 9 + (recordings > 1)
    assert all(total == pytest.approx(1.0) for total in maps.values())


def test_a_residual_below_the_noise_floor_has_no_share() -> None:
    assert all(cell.share == 0 for cell in locate(traces(6), 10 * NOISE_UM))
    silent = record("a", sine(1_000, 20.0), np.zeros(1_000))
    assert all(cell.share == 0 and cell.significance <= 0 for cell in locate([silent], NOISE_UM))


def test_the_normal_score_of_an_f_ratio_matches_the_f_distribution() -> None:
    from scipy.stats import f, norm

    for above, below in ((4.0, 400.0), (30.0, 30.0), (500.0, 5_000.0)):
        for ratio in (0.5, 1.0, 1.5, 2.5):
            exact = norm.isf(f.sf(ratio, above, below))
            if abs(exact) < 6:
                assert normal_score(ratio, above, below) == pytest.approx(exact, abs=0.08)


def test_turning_points_are_where_the_input_reverses() -> None:
    u = np.concatenate(
        [np.linspace(0, 5, 51), np.full(20, 5.0), np.linspace(5, 1, 41), np.linspace(1, 3, 21)]
    )
    u[30] -= 0.01  # no reversal
    assert turning_points(u, 0.05).tolist() == [0, 71, 112]
