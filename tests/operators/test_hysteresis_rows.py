"""Rows of the states of elementary hysteresis operators, and their sums."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import quad

from torchpi.operators.hysteresis_rows import (
    DUHEM_POWERS,
    duhem,
    duhem_rows,
    offsets_of,
    piece_of,
    play_sum,
    sums_of_plain_plays,
    sums_of_plays,
)

VOLTS = st.floats(-10, 10, allow_subnormal=False)


@settings(max_examples=200, deadline=None)
@given(
    v=arrays(np.float64, st.integers(1, 60), elements=VOLTS),
    thresholds=arrays(np.float64, st.integers(1, 8), elements=st.floats(0, 10, allow_subnormal=False)),
    pieces=st.integers(1, 9),
    seed=st.integers(0, 99),
)
def test_sums_of_plays_equal_those_computed_one_play_at_a_time(
    v: np.ndarray, thresholds: np.ndarray, pieces: int, seed: int
) -> None:
    r = np.unique(thresholds)
    low, piece = -7.0, 12.5 / pieces
    slopes = np.random.default_rng(seed).standard_normal((pieces, len(r), 3))
    offsets = np.array(offsets_of(slopes, low, piece))
    one, none = np.ones(len(v)), np.zeros(len(v))
    plain, sums = np.empty((3, len(v))), np.empty((len(v), 3))
    inside = v, v, v, one, one, one, none, r, 0.0, low, piece
    sums_of_plain_plays(v, r, low, piece, slopes, offsets, plain)
    sums_of_plays(*inside, slopes, offsets, np.zeros(len(r)), sums)
    for k in range(3):
        expected = play_sum(*inside, slopes[:, :, k].copy(), offsets[:, :, k].copy())
        np.testing.assert_allclose(plain[k], expected, rtol=0, atol=1e-11)
        np.testing.assert_allclose(sums[:, k], expected, rtol=0, atol=1e-11)


@given(x=st.floats(-30, 30), pieces=st.integers(1, 9), seed=st.integers(0, 99))
def test_an_output_function_is_the_integral_of_its_slopes_from_0(x: float, pieces: int, seed: int) -> None:
    low, piece = -7.0, 12.5 / pieces
    slopes = np.random.default_rng(seed).standard_normal(pieces)
    k = piece_of(x, low, piece, pieces)
    found = slopes[k] * x + offsets_of(slopes, low, piece)[k]
    edges = [-np.inf, *(low + piece * np.arange(1, pieces)), np.inf]
    wanted = sum(
        slope * (np.clip(x, a, b) - np.clip(0.0, a, b))
        for slope, a, b in zip(slopes, edges[:-1], edges[1:], strict=True)
    )
    assert abs(found - wanted) < 1e-10


@settings(max_examples=100, deadline=None)
@given(
    z=st.floats(-1, 1),
    ends=st.tuples(st.floats(-1, 1), st.floats(-1, 1)),
    alpha=st.floats(0.01, 100.0),
    power=st.sampled_from(DUHEM_POWERS),
)
def test_a_duhem_state_follows_its_differential_equation_over_a_step_of_any_size(
    z: float, ends: tuple[float, float], alpha: float, power: int
) -> None:
    """Expect z e^{-A} + ∫ α e^{-α(s_1 - s)} f(v(s)) ds over the path s; one value of f is not enough."""
    before, v = ends
    path = abs(v - before)

    def pulled(left: float) -> float:
        at = v - np.copysign(left, v - before)
        return float(alpha * np.exp(-alpha * left) * at**power)

    expected = z * np.exp(-alpha * path) + quad(pulled, 0, path, epsabs=1e-12, epsrel=1e-10)[0]
    assert abs(duhem(z, v, before, alpha, power) - expected) < 1e-4


@given(v=arrays(np.float64, st.integers(1, 60), elements=VOLTS), alpha=st.floats(0.01, 100.0))
def test_duhem_rows_equal_each_state_alone_to_the_last_bit(v: np.ndarray, alpha: float) -> None:
    for power, row in zip(DUHEM_POWERS, duhem_rows(v, alpha), strict=True):
        z, before = 0.0, 0.0
        for now, found in zip(v.tolist(), row.tolist(), strict=True):
            z, before = duhem(z, now, before, alpha, power), now
            assert z == found


def test_a_duhem_state_stays_constant_while_a_voltage_decays_to_zero() -> None:
    """A lag before the hysteresis leaves voltages of 1e-320 V long after the command has become 0."""
    v: np.ndarray = np.append(np.geomspace(1.0, 1e-300, 700), [1e-320, 5e-324, 0.0])
    rows = duhem_rows(v, 0.3)
    assert np.isfinite(rows).all() and (rows[:, -3:] == rows[:, -4:-3]).all()


def test_a_duhem_state_without_memory_follows_its_function() -> None:
    assert abs(duhem(5.0, -2.0, 3.0, 1e9, 3) + 8.0) < 0.02
