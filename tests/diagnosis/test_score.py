"""The score: better predictions gain, noise does not, and no frequency band outvotes another."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.diagnosis.plants import multisine, record, triangles
from tests.diagnosis.prepared import prepared
from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.fit import WITHHELD, fit, left_out, prior_of, with_prior
from torchpi.diagnosis.haar import CELLS
from torchpi.diagnosis.hypothesis import Fit, Hypothesis
from torchpi.diagnosis.hysteresis_model import plain
from torchpi.diagnosis.noise import Noise
from torchpi.diagnosis.normal_equations import solve
from torchpi.diagnosis.records import Record, seen
from torchpi.diagnosis.repeats import APART, PLAIN
from torchpi.diagnosis.score import AT_MOST, LEAST_IN_STRATUM, Weighting, gain
from torchpi.diagnosis.sensitivity import jacobian
from torchpi.recordings.recording import Recording

SAMPLES, FS_HZ = 1 << 13, 2e3
T = np.arange(SAMPLES) / FS_HZ


def records_of(*residuals: np.ndarray) -> list[Record]:
    """Return prepared recordings as long as the residuals."""
    return prepared(
        [Recording(str(i), np.arange(len(e)) / FS_HZ, e, e, FS_HZ) for i, e in enumerate(residuals)]
    )


def squares(records: Sequence[Record], residuals: Sequence[np.ndarray]) -> np.ndarray:
    """(cells,): mean squares of the residuals."""
    parts = []
    for record_, e in zip(records, residuals, strict=True):
        cell = record_.coefficients.cell
        parts.append(np.bincount(cell, record_.coefficients(e[None])[0] ** 2) / np.bincount(cell))
    return np.concatenate(parts)


def gained(before: np.ndarray, after: np.ndarray) -> float:
    """Return the nats that a model that leaves `after` gains over one that leaves `before`."""
    records = records_of(before)
    weighting = Weighting.of(records, [before], None)
    densities = [weighting.of_squares(squares(records, [e])) for e in (after, before)]
    return gain(*densities).nats


def white(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(SAMPLES)


def test_a_smaller_residual_gains_as_much_as_the_larger_one_loses() -> None:
    noise = white(0)
    tone = np.sin(2 * np.pi * 20 * T)
    records = records_of(noise)
    weighting = Weighting.of(records, [noise + tone], None)
    less, more = (weighting.of_squares(squares(records, [e])) for e in (noise, noise + tone))
    won, lost = gain(less, more), gain(more, less)
    assert won.nats > 30 and won.probability > 0.95
    assert lost.nats == -won.nats and lost.probability == pytest.approx(1 - won.probability)


def test_replacing_one_noise_by_another_gains_nothing_on_average() -> None:
    found = [gained(white(2 * seed), white(2 * seed + 1)) for seed in range(60)]
    assert abs(np.mean(found)) < 4 * np.std(found) / np.sqrt(len(found)) + 1


def test_fitting_noise_with_columns_of_noise_does_not_improve_the_prediction() -> None:
    """Twenty columns that explain nothing reduce the residual but do not improve the prediction."""
    rng, found = np.random.default_rng(7), []
    for seed in range(30):
        e = white(seed)[: SAMPLES // 4]
        records = records_of(e)
        of = records[0].coefficients
        columns, c = of(rng.standard_normal((20, len(e)))), of(e[None])[0]
        weighting = Weighting.of(records, [e], None)
        q, _ = np.linalg.qr(columns.T)
        leverage, left = (q**2).sum(1), c - q @ (q.T @ c)
        n = np.bincount(of.cell)
        cells = [np.bincount(of.cell, x**2) / n for x in (left / (1 - leverage), c, left)]
        densities = [weighting.of_squares(x) for x in cells]
        found.append((gain(densities[0], densities[1]).nats, gain(densities[2], densities[1]).nats))
    predicted, fitted = np.mean(found, axis=0)
    assert predicted < 0 < fitted


def test_a_wide_quiet_band_does_not_outvote_a_slow_improvement() -> None:
    """Removed creep counts for more than an increase by a hundredth on all fast scales."""
    noise = white(3)
    slow = 3.0 * np.log(T + 0.05)
    assert gained(noise + slow - slow.mean(), 1.005 * noise) > 10


def test_removing_one_short_ring_counts_as_a_gain() -> None:
    """The ring lasts 40 ms of 4 s, which is 1 % of the samples."""
    noise = white(4)
    ring = 12.0 * np.exp(-(T - 2) / 0.01) * np.sin(2 * np.pi * 400 * (T - 2)) * (T > 2)
    assert gained(noise + ring, noise) > 5


def test_a_cell_counts_as_a_limited_number_of_coefficients() -> None:
    records = records_of(white(5))
    weighting = Weighting.of(records, [white(5)], None)
    more = replace(weighting, counts=np.where(weighting.counts > AT_MOST, 1e6, weighting.counts))
    q = squares(records, [white(6)])
    assert np.array_equal(weighting.of_squares(q), more.of_squares(q))


def test_the_score_does_not_depend_on_the_unit() -> None:
    before, after = white(8) + np.sin(T), white(8)
    assert gained(1e-3 * before, 1e-3 * after) == pytest.approx(gained(before, after), rel=1e-9)


def linear() -> tuple[Chain, Fit]:
    chain = Chain(prepared([record(multisine(600), name="a"), record(triangles(600), name="b", seed=1)]))
    return chain, fit(chain, Hypothesis(plain(seen(chain.records))))


def test_the_left_out_prediction_of_a_stretch_equals_that_of_a_refit_to_the_others() -> None:
    chain, now = linear()
    nothing = np.zeros(len(now.weights))
    parts = [jacobian(chain, now.hypothesis, nothing, (), np.zeros(0), i)[1] for i in range(2)]
    readings = [chain.whitened(i, r.y[None])[0] for i, r in enumerate(chain.records)]
    rows, y = [], np.concatenate(readings)
    for part in parts:
        full = np.zeros((len(nothing), part.rows.shape[1]))
        full[part.places] = part.rows
        rows.append(full)
    j = np.concatenate(rows, axis=1)
    prior = prior_of(chain, now.hypothesis, j @ j.T)
    weights = solve(*with_prior(j @ j.T, j @ y, prior, nothing))
    residuals = [r.y - chain.output(now.hypothesis, weights, i) for i, r in enumerate(chain.records)]
    shortcut = left_out(chain, residuals, parts, prior)
    of = [record_.coefficients for record_ in chain.records]
    stretch = np.repeat(np.arange(2 * CELLS), np.concatenate([np.diff(one.ends) for one in of]))
    samples = np.repeat([one.samples for one in of], [one.kept for one in of])
    at = np.concatenate([one.at for one in of])
    assert np.array_equal(
        stretch, at * CELLS // samples + CELLS * np.repeat([0, 1], [one.kept for one in of])
    )
    predicted = np.empty(len(y))
    for one in range(2 * CELLS):
        weight = np.where(stretch == one, 1.0 - WITHHELD, 1.0)
        refit = solve(*with_prior(j * weight @ j.T, j @ (weight * y), prior, nothing))
        predicted[stretch == one] = (y - refit @ j)[stretch == one]
    inverse_sd = np.concatenate(chain.weighting.inverse_sd)
    cell = np.concatenate([of[0].cell, of[0].cells + of[1].cell])
    explicit = np.bincount(cell, (predicted / inverse_sd) ** 2) / np.bincount(cell)
    assert shortcut == pytest.approx(explicit, rel=1e-3)


class Left:
    """Stand-in for a fit, with only what the explained share depends on."""

    def __init__(self, left_out_um2: np.ndarray) -> None:
        self.left_out_um2 = left_out_um2


def weighting(cells: int, kinds: np.ndarray | None = None) -> Weighting:
    one, alike = np.ones(cells), np.zeros(cells, dtype=int)
    kinds = alike if kinds is None else kinds
    return Weighting((np.ones(20 * cells),), one, 20 * one, one, kinds, kinds)


def test_an_effect_that_leaves_only_noise_explains_all_and_one_that_leaves_more_a_part() -> None:
    less = Left(np.full(10, 10.0))
    for left, known in ((1.0, 1.0), (5.5, 0.5), (9.99, 0.0)):
        share = weighting(10).explained_where_it_acts(Left(np.full(10, left)), less)
        assert share == pytest.approx(known, abs=0.01)


def test_a_residual_where_an_effect_does_not_act_does_not_count_against_it() -> None:
    now, less = np.full(10, 1.0), np.full(10, 1.0)
    less[:5], now[5:], less[5:] = 50.0, 100.0, 100.0
    assert weighting(10).explained_where_it_acts(Left(now), Left(less)) > 0.99


def test_a_periodic_residual_does_not_count_against_a_non_periodic_effect() -> None:
    now, less = np.full(20, 1.0), np.full(20, 1.0)
    less[:10], now[10:], less[10:] = 50.0, 100.0, 100.0
    apart = np.repeat([APART, PLAIN], 10)
    assert weighting(20).explained_of_all(Left(now), Left(less)) < 0.5
    assert weighting(20, apart).explained_of_all(Left(now), Left(less)) > 0.95


def test_a_small_gain_almost_everywhere_does_not_outvote_the_cells_where_an_effect_acts() -> None:
    now, less = np.full(40, 3.0), np.full(40, 3.1)
    now[:4], less[:4] = 1.0, 200.0
    assert weighting(40).explained_where_it_acts(Left(now), Left(less)) > 0.9


def test_a_gain_on_one_scale_is_as_certain_as_its_cells_agree() -> None:
    strata, worse = np.repeat([0, 1, 2], 8), np.zeros(24)
    steady, once = np.zeros(24), np.zeros(24)
    steady[:8], once[0] = 5.0, 40.0
    assert gain(steady, worse, strata=strata).probability > 0.999
    assert gain(steady, worse).probability < gain(steady, worse, strata=strata).probability
    assert gain(once, worse, strata=strata).probability < 0.75


def test_every_stratum_belongs_to_one_recording_and_has_enough_cells() -> None:
    records = records_of(white(0), white(1))
    strata = Weighting.flat(records).strata
    assert strata is not None and len(strata) == sum(r.coefficients.cells for r in records)
    own = np.repeat([0, 1], [r.coefficients.cells for r in records])
    assert all(len(np.unique(own[strata == one])) == 1 for one in np.unique(strata))
    assert np.bincount(strata).min() >= LEAST_IN_STRATUM


@given(st.integers(0, 999))
def test_the_share_of_the_whole_residual_also_counts_cells_without_a_gain(seed: int) -> None:
    rng = np.random.default_rng(seed)
    now = rng.uniform(2.0, 9.0, 40)
    less = now + np.where(np.arange(40) < 3, rng.uniform(1.0, 50.0), 0.0)
    share = weighting(40).explained_of_all(Left(now), Left(less))
    gained, left = (less - now) @ weighting(40).counts, (now - 1.0) @ weighting(40).counts
    assert share == pytest.approx(gained / (gained + left))


def test_a_residual_counts_as_noise_as_far_as_it_is_white_where_none_was_measured_at_its_rate() -> None:
    white = np.random.default_rng(0).normal(0, 1e-3, SAMPLES)
    walk, elsewhere = np.cumsum(white), Noise(1e-3, np.array([1e-6]), 2 * FS_HZ, "holds of the voltage")
    structured = Weighting.of(records_of(walk), [walk], elsewhere)
    assert np.median(structured.level_um2) > 10 * structured.floor_um2.max() > 0
    alike = Weighting.of(records_of(white), [white], elsewhere)
    assert alike.mean_floor_um2 == pytest.approx(1e-6, rel=0.1)
    assert Weighting.of(records_of(white), [white], None).mean_floor_um2 == alike.mean_floor_um2
    assert Weighting.of(records_of(walk), [walk], None).mean_floor_um2 == 0.0
