"""The mean of fits on two grids is one bank of plays, no larger, that cannot run backwards."""

import numpy as np
import torch

from tests.identification.test_fits import PERIOD, pairs, truth
from torchpi.control.direct_inverse import DirectInverse
from torchpi.identification import InversePair
from torchpi.identification.grid_average import average_over_grids
from torchpi.identification.monotone import monotone
from torchpi.identification.monotone_problem import MonotoneProblem
from torchpi.identification.recipe import spread_thresholds
from torchpi.identification.selection import Form, Richest, select_form

GRIDS = (0.45, 0.6)


def inverse(thresholds: list[float]) -> DirectInverse:
    return DirectInverse(PERIOD, thresholds, degree=2, range_um=4.0, offset=True)


def problems_on(grids: list[list[float]], record: InversePair) -> list[MonotoneProblem]:
    return [MonotoneProblem(inverse(grid), [record]) for grid in grids]


def voltage(compensator: DirectInverse, record: InversePair) -> torch.Tensor:
    with torch.no_grad():
        u, _ = compensator.voltage(record.motion)
    return u


def test_it_has_the_mean_voltage_where_one_grid_holds_the_thresholds_of_the_other() -> None:
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


def test_it_has_the_mean_polynomial_and_does_not_run_backwards() -> None:
    [record] = pairs(truth(), (1500,), noise_v=0.05)
    problems = problems_on([spread_thresholds(9, 4.0, spread) for spread in GRIDS], record)
    averaged = average_over_grids(problems, [np.array([-0.02]), np.array([0.03])])
    other = problems_on([spread_thresholds(9, 4.0, 0.6)], record)[0]
    other.put(np.array([0.005]), other.solve(np.array([0.005])).beta)
    torch.testing.assert_close(averaged.saturation.c, other.compensator.saturation.c)
    y = record.motion.yd
    assert monotone(averaged, (min(0.0, float(y.min())), float(y.max())), (-1.0, 1.0))


def test_only_a_single_record_with_thresholds_that_are_not_given_is_averaged() -> None:
    made: list[float] = []

    def build(form: Form, _: object) -> DirectInverse:
        made.append(form.spread)
        return inverse(spread_thresholds(5, 4.0, form.spread))

    records = pairs(truth(rate="none"), (900, 700), noise_v=0.01)
    plain = dict(previews=range(1), degree=1, lead=0, creep_time_constants_s=(), rate=False)
    for count, spreads, last in ((1, (0.45, 0.3), [0.45, 0.6]), (1, (0.45,), [0.45]), (2, (0.45,), [0.45])):
        made.clear()
        selected = select_form(build, lambda _, n=count: records[:n], Richest(**plain, spreads=spreads))  # type: ignore[arg-type,misc]
        assert made[-len(last) :] == last
        assert selected.steps[-1].form.spread == last[-1]
