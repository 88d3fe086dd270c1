"""Separation of what repeats with a periodic voltage from what does not."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.diagnosis.plants import record
from tests.diagnosis.prepared import prepared
from torchpi.diagnosis import diagnose
from torchpi.diagnosis.noise import measured_noise
from torchpi.diagnosis.repeats import APART, PLAIN, STARTING, Repeats, Stretch, periodic_stretches
from torchpi.diagnosis.score import Weighting
from torchpi.excitation.signals import multisine as random_phase
from torchpi.recordings.recording import Recording

FS_HZ = 5_000.0
_, U = random_phase(8.0, FS_HZ, 0, 10, 1, 200, 2, odd_lines=True, detection_lines=True, seed=2)


def test_the_period_is_found_after_a_ramp() -> None:
    assert periodic_stretches(U) == (Stretch(len(U) - 40_000, 20_000, 2),)


def test_triangles_and_sines_are_periodic() -> None:
    t = np.arange(20_000) / FS_HZ
    assert periodic_stretches(np.sin(2 * np.pi * 5 * t))[0] == Stretch(0, 1_000, 20)
    (triangle,) = periodic_stretches(np.abs((t * 2 + 1) % 2 - 1))
    assert triangle.period == 5_000


@given(st.sampled_from(["walk", "sweep", "rest", "stairs", "decay", "noise", "steps"]), st.integers(0, 2**31))
def test_an_aperiodic_signal_is_not_called_periodic(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(200, 20_000))
    t = np.arange(n) / FS_HZ
    u = {
        "walk": np.cumsum(rng.standard_normal(n)),
        "sweep": np.sin(2 * np.pi * (1 + 20 * t) * t),
        "rest": np.full(n, rng.uniform(0, 10)),
        "stairs": np.floor(t * 8) * 0.5,
        "decay": np.abs((t * 3) % 2 - 1) * (1 - t / (n / FS_HZ * 1.5)),
        "noise": rng.standard_normal(n),
        "steps": np.repeat(rng.uniform(0, 10, n // 100 + 1), 100)[:n],
    }[kind]
    assert periodic_stretches(u) == ()


def periodic(before: int, period: int, periods: int, after: int, seed: int) -> np.ndarray:
    """Return noise with parts of these lengths, one of which repeats."""
    rng = np.random.default_rng(seed)
    parts = (
        rng.standard_normal(before),
        np.tile(rng.standard_normal(period), periods),
        rng.standard_normal(after),
    )
    return np.concatenate(parts)


lengths = st.tuples(
    st.integers(0, 90), st.integers(70, 200), st.integers(2, 6), st.integers(0, 90), st.integers(0, 99)
)


@given(lengths, st.floats(0.0, 0.2), st.floats(0.6, 1.0))
def test_white_noise_stays_white_and_excluded_readings_have_no_influence(
    shape: tuple[int, int, int, int, int], wrong: float, share: float
) -> None:
    u = periodic(*shape)
    rng = np.random.default_rng(shape[-1])
    samples, valid = int(share * len(u)), rng.uniform(size=len(u)) >= wrong
    repeats = Repeats.of(u, samples, valid)
    rotation = repeats(np.eye(len(u)))[:, repeats.apart]  # (from, to)
    assert rotation.T @ rotation == pytest.approx(np.eye(int(repeats.apart.sum())), abs=1e-9)
    row = rng.standard_normal((1, len(u)))
    assert np.array_equal(repeats(row), repeats(np.where(valid, row, 1e6)))
    assert not repeats(row)[:, ~repeats.apart].any()


@given(lengths, st.floats(0.0, 0.2))
def test_a_periodic_signal_vanishes_from_the_non_periodic_part(
    shape: tuple[int, int, int, int, int], wrong: float
) -> None:
    u = periodic(*shape)
    samples, valid = int(0.85 * len(u)), np.random.default_rng(0).uniform(size=len(u)) >= wrong
    repeats = Repeats.of(u, samples, valid)
    apart = repeats(np.sin(3 * u)[None])[0][repeats.apart]
    sealed = repeats.beyond(np.sin(3 * u))
    assert np.abs(apart).max(initial=0.0) < 1e-9
    assert np.abs(sealed[np.isfinite(sealed)]).max(initial=0.0) < 1e-9


def test_the_sealed_end_is_compared_with_earlier_periods_while_the_voltage_repeats() -> None:
    u = periodic(0, 200, 5, 40, 1)
    repeats = Repeats.of(u, 850, np.ones(len(u), bool))
    drift = np.where(np.arange(len(u)) < 850, 0.0, 1.0)
    sealed = repeats.beyond(drift)
    assert np.isfinite(sealed).tolist() == [True] * 150 + [False] * 40
    # The mean of four periods (five where the phase occurs once more) has an error of its own.
    assert sealed[:150] == pytest.approx(np.sqrt(4 / 5))


def test_the_non_periodic_part_has_its_own_coefficients_beside_those_of_all_readings() -> None:
    u = np.concatenate([np.linspace(0, U[-20_000], 500), U[-40_000:], U[-20_000:], np.linspace(0, 5, 12_000)])
    (one,) = prepared([record(u, fs_hz=FS_HZ)])
    of = one.coefficients
    assert [kind for _, _, kind in of.repeats.pieces] == [STARTING, APART]
    repeated, ramp = np.sin(u), np.linspace(0, 1, len(u))
    energy = [np.bincount(of.kind_of_cell[of.cell], of(e[None])[0] ** 2) for e in (repeated, ramp)]
    assert energy[0][APART] < 1e-20 * energy[0][PLAIN] and energy[1][APART] > 1e-3 * energy[1].sum()
    (_, readings, places) = of.pieces[0]
    assert np.array_equal(of(one.y[None])[:, places], readings.full(one.y[None])[:, readings.kept])


def test_without_repeats_only_the_readings_have_coefficients() -> None:
    (one,) = prepared([record(np.cumsum(np.random.default_rng(0).standard_normal(3000)))])
    assert set(one.coefficients.kind_of_cell) == {PLAIN} and len(one.coefficients.pieces) == 1


def test_an_unmodelled_start_transient_weighs_about_as_much_as_what_recurs_in_each_period() -> None:
    (one,) = records = prepared([record(np.tile(U[-20_000::20], 6), fs_hz=250.0)])
    noise = measured_noise(records)
    ringing = 2.0 * np.sin(9 * one.u)
    (inverse_sd,) = Weighting.of(records, [ringing], noise).inverse_sd
    kind = one.coefficients.kind_of_cell[one.coefficients.cell]
    assert np.median(inverse_sd[kind == STARTING]) < 3 * np.median(inverse_sd[kind == PLAIN])
    assert np.median(inverse_sd[kind == APART]) > 30 * np.median(inverse_sd[kind == STARTING])


def ripples(drift_um: float, seed: int = 0) -> Recording:
    """Record twelve periods of a stage with a ripple that no effect models, ten times the noise, in a room
    whose temperature wanders."""
    u = np.tile(U[-20_000::40], 12)
    hours = np.random.default_rng(seed).standard_normal(7)
    drift = np.interp(np.arange(len(u)), np.linspace(0, len(u), 7), hours - hours[0])
    error = 0.04 * np.sin(9 * u) + drift_um * drift
    return record(u, fs_hz=125.0, after=lambda x, fs_hz: x + error)


@pytest.mark.parametrize("drift_um", [0.0, 0.02])
def test_a_drift_is_found_beneath_an_unmodelled_periodic_residual_only_if_present(drift_um: float) -> None:
    found = diagnose([ripples(drift_um)])
    slow = {"thermal_drift", "gain_modulation", "ageing", "creep", "leakage"}
    assert slow & {effect.name for effect in found.effects} == ({"thermal_drift"} if drift_um else set())
