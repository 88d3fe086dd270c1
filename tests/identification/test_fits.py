"""Fits recover the model behind a record from wrong starts, no worse than a general optimiser."""

import numpy as np
import pytest
import scipy.optimize
import torch

from torchpi.control.direct_inverse import DirectInverse
from torchpi.identification import InversePair, fit_joint, fit_two_stage
from torchpi.identification.joint import joint_problem
from torchpi.identification.levenberg_marquardt import levenberg_marquardt
from torchpi.identification.two_stage import fit_saturation
from torchpi.operators.motion import Motion

PERIOD = 1e-3
THRESHOLDS = [0.0, 0.2, 0.5, 0.9, 1.4]


def wandering(seed: int, samples: int) -> Motion:
    """Return a motion from 0 to 4 µm with reversals of all sizes, and its derivatives."""
    t = PERIOD * np.arange(samples)
    random = np.random.default_rng(seed)
    y, rate = np.zeros(samples), np.zeros(samples)
    for hz in (1.3, 3.1, 7.7, 11.0):
        phase = random.uniform(0, 2 * np.pi)
        y += np.sin(2 * np.pi * hz * t + phase)
        rate += 2 * np.pi * hz * np.cos(2 * np.pi * hz * t + phase)
    low, span = y.min(), np.ptp(y)
    y, rate = 4 * (y - low) / span, 4 * rate / span
    return Motion(*(torch.from_numpy(part)[None] for part in (y, rate, np.gradient(rate, PERIOD))))


def pairs(made: DirectInverse, lengths: tuple[int, ...], noise_v: float = 0.0) -> list[InversePair]:
    """Return records of these lengths, with the voltages that `made` needs for them."""
    found = []
    for seed, samples in enumerate(lengths):
        motion = wandering(seed, samples)
        with torch.no_grad():
            u = made.voltage(motion)[0]
        u = u + noise_v * torch.from_numpy(np.random.default_rng(seed).standard_normal(u.shape))
        found.append(InversePair(str(seed), motion, u, slice(50, None), PERIOD))
    return found


def truth(**form: object) -> DirectInverse:
    made = DirectInverse(PERIOD, THRESHOLDS, degree=2, range_um=4.0, rate_scale_um_s=100.0, **form)
    made.saturation.set_coefficients(torch.tensor([1.2, -0.03], dtype=torch.float64))
    with torch.no_grad():
        made.weights.theta[:, 0] = torch.tensor([1.0, -0.1, -0.15, -0.1, -0.2])
    return made


def test_the_fits_recover_all_parameters_of_the_true_inverse() -> None:
    made = truth(lead=2, creep_time_constants_s=[0.02, 0.3], offset=True)
    with torch.no_grad():
        made.scaled_lead.copy_(torch.tensor([1.5, 0.4]))
        made.creep_gains.copy_(torch.tensor([-0.03, 0.05]))
        made.weights.theta[:, 1] = torch.tensor([0.02, 0.01, 0.0, -0.01, 0.005])
        made.offset.fill_(0.6)
    records = pairs(made, (1500, 900, 2200))
    fitted = DirectInverse(**made.hyper_parameters)
    fit_two_stage(fitted, records)
    assert fit_joint(fitted, records) < 2e-4  # V, of 5 V; due to the ridge on the weights
    assert fitted.scaled_lead.tolist() == pytest.approx([1.5, 0.4], rel=2e-2)
    assert fitted.creep_gains.tolist() == pytest.approx([-0.03, 0.05], rel=2e-2)
    assert fitted.offset.item() == pytest.approx(0.6, abs=1e-2)
    ratio = (fitted.saturation.c / made.saturation.c).tolist()
    assert ratio[1] == pytest.approx(ratio[0], rel=5e-2)


def test_the_joint_fit_recovers_the_true_thresholds_if_they_are_free() -> None:
    made = truth()
    [record] = pairs(made, (3000,))
    start = [1.12 * r + 0.03 * (r > 0) for r in THRESHOLDS]
    scales = {"range_um": 4.0, "rate_scale_um_s": 100.0}
    fitted = DirectInverse(PERIOD, start, degree=2, rate="none", train_thresholds=True, **scales)
    fit_saturation(fitted, [record])
    assert fit_joint(fitted, [record]) < 2e-4
    # Only the ratio of the thresholds to the scale of S can be identified from the record.
    scale = (fitted.saturation.c[0] / made.saturation.c[0]).item()
    assert (fitted.plays.r / scale).tolist() == pytest.approx(THRESHOLDS, rel=1e-2)
    assert fitted.plays.r[0] == 0.0


def test_free_thresholds_stay_positive() -> None:
    [record] = pairs(truth(), (1500,), noise_v=0.02)
    fitted = DirectInverse(PERIOD, [0.0, 1e-3, 2e-3, 3.0], degree=1, range_um=4.0, train_thresholds=True)
    fit_joint(fitted, [record])
    assert (fitted.plays.r[1:] > 0).all()


@pytest.mark.parametrize("seed", range(4))
def test_stage_1_is_no_worse_than_scipy_on_random_problems(seed: int) -> None:
    """The reference also solves for the weights, by finite differences, from S = x and from the truth."""
    random = np.random.default_rng(seed)
    made = truth()
    with torch.no_grad():
        made.saturation.scaled *= torch.from_numpy(random.uniform(1.1, 1.6, 2))
        made.weights.theta[:, 0] *= torch.from_numpy(random.uniform(0.5, 1.5, 5))
    [record] = pairs(made, (800,), noise_v=0.02)
    fitted = DirectInverse(PERIOD, THRESHOLDS, degree=3, range_um=4.0, rate_scale_um_s=100.0)
    reference = DirectInverse(**fitted.hyper_parameters)
    u = record.u[0, record.counted].numpy()

    def residual(scaled: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            reference.saturation.scaled.copy_(torch.from_numpy(scaled))
            h = reference.play_states(record.motion)[0][0, record.counted].numpy()
        return np.asarray(h @ np.linalg.lstsq(h, u, rcond=None)[0] - u)

    starts = [np.array([1.0, 0.0, 0.0]), np.append(made.saturation.scaled.detach().numpy(), 0.0)]
    best = min(scipy.optimize.least_squares(residual, start).cost for start in starts)
    assert fit_saturation(fitted, [record]) <= 1.001 * np.sqrt(2 * best / len(u))


def test_several_starts_leave_no_larger_error_than_one_start() -> None:
    better = 0
    for seed in range(4):
        random = np.random.default_rng(seed)
        made = truth()
        with torch.no_grad():
            made.saturation.scaled *= torch.from_numpy(random.uniform(1.5, 3.0, 2))
        [record] = pairs(made, (800,), noise_v=0.02)
        several, once = (DirectInverse(PERIOD, THRESHOLDS, degree=3, range_um=4.0) for _ in range(2))
        left_v = fit_saturation(several, [record])
        once_v = fit_saturation(once, [record], several_starts=False)
        assert left_v <= 1.001 * once_v
        better += left_v < 0.99 * once_v
    assert better >= 1


def test_a_descent_continues_if_it_can_beat_the_best_objective_and_otherwise_gives_up() -> None:
    [record] = pairs(truth(lead=1), (1200,), noise_v=0.02)
    start = DirectInverse(PERIOD, THRESHOLDS, degree=2, range_um=4.0, rate_scale_um_s=100.0, lead=1)
    problem = joint_problem(start, [record])
    alpha, found = levenberg_marquardt(problem, problem.alpha, 100, 1e-4)
    beaten, _ = levenberg_marquardt(problem, problem.alpha, 100, 1e-4, 1.01 * found.objective)
    assert (beaten == alpha).all()
    given_up, _ = levenberg_marquardt(problem, alpha, 100, 1e-6, 0.5 * found.objective)
    assert (given_up == alpha).all()


def test_the_joint_fit_never_increases_the_error_and_reports_it_exactly() -> None:
    records = pairs(truth(lead=1), (1200, 700), noise_v=0.05)
    fitted = DirectInverse(
        PERIOD, THRESHOLDS, degree=3, range_um=4.0, rate_scale_um_s=100.0, lead=1, rate="neural", hidden=2
    )
    before = fit_joint(fitted, records, evaluations=1)
    after = fit_joint(fitted, records)
    assert 0.04 < after <= before
    errors = [(fitted.voltage(one.motion)[0] - one.u)[0, one.counted].detach() for one in records]
    assert torch.cat(errors).square().mean().sqrt().item() == pytest.approx(after, rel=1e-9)


def test_the_fit_rejects_scales_of_s_at_which_the_widest_play_hardly_moves() -> None:
    """Such a scale fits the loop of one sine slightly better, but loops of other amplitudes much worse."""
    made = truth()
    t = PERIOD * np.arange(3000)
    y = 2 - 2 * np.cos(2 * np.pi * t)
    motion = Motion(*(torch.from_numpy(part)[None] for part in (y, np.gradient(y, PERIOD), np.zeros_like(y))))
    with torch.no_grad():
        u = made.voltage(motion)[0] + 0.03 * torch.sin(3 * motion.yd)
    record = InversePair("one loop", motion, u, slice(1000, None), PERIOD)
    fitted = DirectInverse(PERIOD, [0.0, 0.1, 0.3, 0.6, 1.0], degree=4, range_um=4.0, rate="none")
    problem = joint_problem(fitted, [record]).bounded()
    assert np.isfinite(problem.solve(problem.alpha).objective)
    assert np.isinf(problem.solve(0.5 * problem.alpha).objective)
    fit_saturation(fitted, [record])
    s, _ = fitted.saturation(torch.linspace(0, 4, 50, dtype=torch.float64)[None])
    assert 2 * float(fitted.plays.r.max()) <= 0.64 * float((s.max() - s.min()).detach())
