"""Haar coefficients: energy is kept, white noise is alike on all scales, masked readings do not count."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from torchpi.diagnosis.haar import CELLS, COARSEST, LEAST_IN_CELL, Haar


def whole(samples: int, valid: np.ndarray | None = None, at_most: int = 10**6) -> Haar:
    mask = np.ones(samples, bool) if valid is None else valid
    return Haar.of(np.arange(samples, dtype=float) ** 1.5, samples, mask, at_most)


@given(st.integers(1, 700), st.integers(0, 99))
def test_the_transform_is_orthonormal(samples: int, seed: int) -> None:
    haar, rows = whole(samples), np.random.default_rng(seed).standard_normal((2, samples))
    full = haar.full(rows)
    assert full @ full.T == pytest.approx(rows @ rows.T, rel=1e-9, abs=1e-9)


@given(st.integers(32, 700), st.integers(0, 99), st.floats(0.0, 0.3))
def test_masked_readings_do_not_count(samples: int, seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    valid = rng.uniform(size=samples) >= share
    haar, row = whole(samples, valid), rng.standard_normal(samples)
    other = np.where(valid, row, 1e6)
    assert np.array_equal(haar.full(row[None]), haar.full(other[None]))
    assert haar.support()[haar.kept].min() > 0.5  # more of the readings under it count than are masked


@given(st.integers(100, 3000), st.integers(50, 500))
def test_every_coefficient_has_one_cell_and_one_level(samples: int, at_most: int) -> None:
    haar = whole(samples, at_most=at_most)
    assert len(set(haar.kept.tolist())) == len(haar.kept)
    assert (np.diff(haar.cell) >= 0).all() and set(np.diff(haar.cell)) <= {0, 1} and haar.cell[0] == 0
    for cell in range(haar.cells):
        assert len(set(haar.level[haar.cell == cell])) == 1
    counts, levels = np.bincount(haar.cell), np.bincount(haar.level)
    assert max(levels) <= at_most + 1
    for level in range(1, haar.levels + 1):
        cells = len(set(haar.cell[haar.level == level]))
        assert cells <= CELLS and counts[haar.cell[haar.level == level]].min() >= LEAST_IN_CELL
    assert haar.at.min() >= 0 and haar.at.max() < samples
    assert len(haar.full(np.zeros((1, samples)))[0]) // 2**haar.levels >= COARSEST


def test_white_noise_has_the_same_variance_on_all_levels() -> None:
    haar = whole(1 << 15)
    full = haar.full(np.random.default_rng(0).standard_normal((40, 1 << 15)))
    for level in range(1, haar.levels + 2):
        first, stop = haar.places(level)
        assert full[:, first:stop].var() == pytest.approx(1.0, abs=5 / np.sqrt(40 * (stop - first)))


def test_a_short_ring_and_a_slow_creep_fall_into_different_cells() -> None:
    t = np.arange(1 << 14) / 2e3
    ring = np.exp(-(t - 3) / 0.01) * np.sin(2 * np.pi * 400 * (t - 3)) * (t > 3)
    haar = whole(len(t))
    energy = [np.bincount(haar.cell, haar.full(e[None])[0, haar.kept] ** 2) for e in (ring, np.log(t + 0.1))]
    most = [set(np.flatnonzero(e > 0.05 * e.sum())) for e in energy]
    assert most[0] and most[1] and not most[0] & most[1]


def test_the_largest_coefficients_are_kept_where_not_all_can_be() -> None:
    activity = np.zeros(8192)
    activity[5001] = 1.0  # the second of its pair: an edge inside one difference
    haar = Haar.of(activity, 8192, np.ones(8192, bool), 100)
    size = np.abs(haar.full(activity[None])[0])
    assert set(np.flatnonzero(size > 0)) <= set(haar.kept)
