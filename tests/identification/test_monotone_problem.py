"""Constrained weights guarantee a monotone inverse, at no cost if it is monotone anyway."""

import numpy as np
import pytest
import torch

from tests.identification.test_fits import pairs, truth, wandering
from torchpi.control.direct_inverse import DirectInverse
from torchpi.identification import InversePair
from torchpi.identification.levenberg_marquardt import levenberg_marquardt
from torchpi.identification.monotone import monotone
from torchpi.identification.monotone_problem import MonotoneProblem
from torchpi.identification.two_stage import fit_two_stage

PERIOD = 1e-3


def form(**more: object) -> DirectInverse:
    options: dict[str, object] = dict(degree=2, range_um=4.0, rate_scale_um_s=100.0, rate="none")
    return DirectInverse(PERIOD, [0.0, 0.2, 0.5, 0.9, 1.4], **(options | more))


def fitted(compensator: DirectInverse, records: list[InversePair]) -> float:
    problem = MonotoneProblem(compensator, records)
    alpha, solved = levenberg_marquardt(problem, problem.alpha, 60, 1e-5)
    problem.put(alpha, solved.beta)
    return float(solved.mean_square**0.5)


def hostile(seed: int, sign: float = 1.0) -> InversePair:
    """Return a record whose voltage runs backwards just after each reversal, and with the rate."""
    motion = wandering(seed, 1500)
    u = sign * (motion.yd - 0.02 * motion.yd_dot) + 0.4 * torch.sin(9 * motion.yd)
    return InversePair(str(seed), motion, u, slice(50, None), PERIOD)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("rate", ["none", "linear"])
@pytest.mark.parametrize("seed", range(3))
def test_the_inverse_never_runs_backwards_over_the_recorded_range_and_rates(
    seed: int, rate: str, sign: float
) -> None:
    record = hostile(seed, sign)
    yd, rates = (part[0, record.counted] for part in record.motion[:2])
    over = (float(yd.min()), float(yd.max())), (float(rates.min()), float(rates.max()))
    free, bound = form(rate=rate, degree=3), form(rate=rate, degree=3)
    fit_two_stage(free, [record])
    fitted(bound, [record])
    assert monotone(bound, *over)
    if rate == "linear":
        assert not monotone(free, *over)  # as the record itself runs backwards


def test_the_constrained_fit_recovers_an_inverse_that_is_already_monotone() -> None:
    made = truth(rate="linear", lead=1, creep_time_constants_s=[0.3], offset=True)
    with torch.no_grad():
        made.scaled_lead.fill_(1.5)
        made.creep_gains.fill_(0.05)
        made.weights.theta[:, 1] = torch.tensor([0.02, 0.01, 0.0, -0.01, 0.005])
        made.offset.fill_(0.6)
    # The problem assumes this scale of S: S(4) = 4.
    made.saturation.set_coefficients(torch.tensor([1.12, -0.03], dtype=torch.float64))
    records = pairs(made, (1500, 2200))
    found = DirectInverse(**made.hyper_parameters)
    assert fitted(found, records) < 1e-3  # V, of 5
    assert found.scaled_lead.item() == pytest.approx(1.5, rel=5e-2)
    assert found.creep_gains.item() == pytest.approx(0.05, rel=5e-2)
    assert found.offset.item() == pytest.approx(0.6, abs=2e-2)


def test_the_polynomial_rises_by_as_much_as_the_displacement() -> None:
    record = hostile(0)
    compensator = form(degree=3)
    fitted(compensator, [record])
    yd = record.motion.yd[:, record.counted]
    ends = torch.stack([yd.min(), yd.max()])[None]
    s, _ = compensator.saturation(ends)
    assert float(s.diff().detach()) == pytest.approx(float(ends.diff()), rel=1e-9)


def test_a_decreasing_polynomial_has_an_infinite_objective() -> None:
    problem = MonotoneProblem(form(), [hostile(1)])
    assert np.isfinite(problem.solve(np.array([0.1])).objective)
    assert np.isinf(problem.solve(np.array([0.5])).objective)


@pytest.mark.parametrize("stiffness", [0.0, 1.0])
def test_the_linearisation_gives_the_gradient_of_the_objective(stiffness: float) -> None:
    [record] = pairs(truth(), (1500,), noise_v=0.05)
    made = form(lead=1, creep_time_constants_s=[0.1], offset=True)
    problem = MonotoneProblem(made, [record]).stiffened(stiffness)
    alpha = np.array([3e-4, 0.02, 0.01])
    solved = problem.solve(alpha)
    linearised = problem.linearise(alpha, solved.beta)
    slopes = -2 * linearised.slopes.T @ linearised.error
    for k, step in enumerate((1e-7, 1e-5, 1e-5)):
        ends = [problem.solve(alpha + sign * step * np.eye(3)[k]).objective for sign in (1, -1)]
        assert slopes[k] == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=2e-2, abs=1e-7)


def test_s_bends_less_at_higher_stiffness() -> None:
    [record] = pairs(truth(), (1500,), noise_v=0.05)
    bends = []
    for stiffness in (0.0, 1.0, 100.0):
        problem = MonotoneProblem(form(), [record]).stiffened(stiffness)
        alpha, _ = levenberg_marquardt(problem, problem.alpha, 60, 1e-6)
        bends.append(float(np.abs(alpha).max()))
    assert bends[0] > bends[1] > bends[2] > 0.0


def test_only_the_given_rows_are_fitted() -> None:
    clean, spoilt = pairs(truth(), (1500, 1500))
    u = spoilt.u.clone()
    u[:, 700:] += 3.0
    problem = MonotoneProblem(form(), [clean, spoilt._replace(u=u)], [np.arange(0), np.arange(50, 700)])
    _, solved = levenberg_marquardt(problem, problem.alpha, 60, 1e-5)
    assert solved.mean_square**0.5 < 2e-2
    assert problem.samples == 650
