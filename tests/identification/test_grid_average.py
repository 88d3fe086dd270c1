"""The mean of fits on several grids is a single bank of plays, no larger, which cannot run backwards."""

import numpy as np
import pytest
import torch

from tests.identification.test_fits import PERIOD, pairs, truth
from torchpi.control.direct_inverse import DirectInverse
from torchpi.identification import InversePair
from torchpi.identification.grid_average import average_over_grids, shows_first_loading
from torchpi.identification.monotone import monotone
from torchpi.identification.monotone_problem import MonotoneProblem
from torchpi.identification.recipe import spread_thresholds
from torchpi.identification.selection import Form, Richest, _Search, _Trial, select_form
from torchpi.operators.motion import Motion

GRIDS = (0.45, 0.6)


def inverse(thresholds: list[float]) -> DirectInverse:
    return DirectInverse(PERIOD, thresholds, degree=2, range_um=4.0, offset=True)


def build(form: Form, _: object) -> DirectInverse:
    grid = spread_thresholds(5, 4.0, form.spread)
    return DirectInverse(PERIOD, grid, degree=form.degree, range_um=4.0, offset=True)


def problems_on(grids: list[list[float]], record: InversePair) -> list[MonotoneProblem]:
    return [MonotoneProblem(inverse(grid), [record]) for grid in grids]


def voltage(compensator: DirectInverse, record: InversePair) -> torch.Tensor:
    with torch.no_grad():
        u, _ = compensator.voltage(record.motion)
    return u


def test_the_average_has_the_mean_voltage_if_one_grid_contains_the_other() -> None:
    [record] = pairs(truth(rate="none"), (1500,), noise_v=0.01)
    fine = spread_thresholds(9, 4.0, 0.6)
    alpha = problems_on([fine], record)[0].alpha
    alone = problems_on([fine[:7:2], fine], record)
    for problem in alone:
        problem.put(alpha, problem.solve(alpha).beta)
    mean = torch.stack([voltage(problem.compensator, record) for problem in alone]).mean(0)
    averaged = average_over_grids(problems_on([fine[:7:2], fine], record), [alpha, alpha])
    assert averaged.plays.r.tolist() == fine
    torch.testing.assert_close(voltage(averaged, record), mean, rtol=0, atol=1e-12)


def test_the_average_has_the_mean_polynomial_and_does_not_run_backwards() -> None:
    [record] = pairs(truth(), (1500,), noise_v=0.05)
    problems = problems_on([spread_thresholds(9, 4.0, spread) for spread in GRIDS], record)
    averaged = average_over_grids(problems, [np.array([-0.02]), np.array([0.03])])
    other = problems_on([spread_thresholds(9, 4.0, 0.6)], record)[0]
    other.put(np.array([0.005]), other.solve(np.array([0.005])).beta)
    torch.testing.assert_close(averaged.saturation.c, other.compensator.saturation.c)
    y = record.motion.yd
    assert monotone(averaged, (min(0.0, float(y.min())), float(y.max())), (-1.0, 1.0))


def test_the_mean_takes_missing_coefficients_of_a_lower_degree_as_zero() -> None:
    [record] = pairs(truth(), (1500,), noise_v=0.05)
    problems = problems_on([spread_thresholds(9, 4.0, spread) for spread in GRIDS], record)
    straight, half = (
        average_over_grids(problems, alphas).saturation.c.tolist()
        for alphas in ([np.zeros(0)] * 2, [np.zeros(0), np.array([0.06])])
    )
    other = problems[0]
    other.put(np.array([0.03]), other.solve(np.array([0.03])).beta)
    assert straight == pytest.approx([1.0, 0.0]) and half == pytest.approx(
        other.compensator.saturation.c.tolist()
    )


def from_rest(samples: int) -> InversePair:
    """Return a record of five periods of a sine from the de-energised state."""
    t = np.arange(samples) * PERIOD
    w = 10 * np.pi / t[-1]
    parts = 2 - 2 * np.cos(w * t), 2 * w * np.sin(w * t), 2 * w**2 * np.cos(w * t)
    motion = Motion(*(torch.from_numpy(part)[None] for part in parts))
    with torch.no_grad():
        u = truth(rate="none").voltage(motion)[0]
    return InversePair("sine", motion, u, slice(0, None), PERIOD)


def test_only_a_record_from_rest_shows_the_first_loading() -> None:
    record = from_rest(1500)
    assert shows_first_loading(record, 0.45)
    assert not shows_first_loading(record._replace(counted=slice(200, None)), 0.45)
    lifted = record.motion._replace(yd=record.motion.yd + 2.0)
    assert not shows_first_loading(record._replace(motion=lifted), 0.45)


@pytest.mark.parametrize(
    ("start", "spreads", "averaged"),
    [(0, (0.45, 0.3), True), (200, (0.45, 0.3), False), (0, (0.45,), False)],
    ids=["from rest", "within its loops", "thresholds given"],
)
def test_a_single_record_is_averaged_only_if_it_shows_the_first_loading(
    start: int, spreads: tuple[float, ...], averaged: bool
) -> None:
    record = from_rest(1500)._replace(counted=slice(start, None))
    richest = Richest(range(1), degree=1, lead=0, creep_time_constants_s=(), rate=False, spreads=spreads)
    selected = select_form(build, lambda _: [record], richest)
    spread = 0.7 if averaged else 0.45
    assert selected.steps[-1].form.spread == spread
    assert selected.compensator.plays.r.tolist() == spread_thresholds(5, 4.0, spread)


BENT = Richest(range(1), degree=2, lead=0, creep_time_constants_s=(), rate=False)


def test_if_blocks_and_all_folds_disagree_on_the_degree_s_has_half_the_bend(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    search = _Search(build, lambda _: [from_rest(1500)], BENT)

    def fitted(degree: int, of_blocks: int) -> tuple[float, float]:
        monkeypatch.setattr(search, "degree_of_blocks", lambda _: of_blocks)
        form, compensator = search.fitted(Form(degree=degree))
        c = compensator.saturation.c.tolist()
        return form.spread, c[1] if form.degree == 2 else 0.0

    whole = fitted(2, 2)
    assert abs(whole[1]) > 1e-3 and fitted(1, 1) == (0.7, 0.0)
    assert fitted(1, 2) == fitted(2, 1) == pytest.approx((0.6, 0.5 * whole[1]))


@pytest.mark.parametrize(
    ("ratios", "degree"),
    [([0.9, 0.91, 0.89, 0.9, 0.9], 2), ([0.99, 0.7, 0.95, 0.9, 1.0], 1), ([1.0] * 5, 1)],
    ids=["all lower", "within two standard errors", "equal"],
)
def test_blocks_accept_a_bend_only_if_better_by_two_standard_errors(
    ratios: list[float], degree: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    search = _Search(build, lambda _: [from_rest(1500)], BENT)

    def tried(form: Form, start: _Trial | None = None) -> _Trial:
        slow_and_fast = [2.0, 2.0]  # these folds must not count
        return _Trial(form, [], np.array([*ratios, *slow_and_fast]) ** 2 if form.degree == 2 else np.ones(7))

    monkeypatch.setattr(search, "tried", tried)
    assert search.degree_of_blocks(Form()) == degree
