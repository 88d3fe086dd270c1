"""Al Janaideh–Krejčí: time-varying thresholds, inverted exactly while they dilate."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.control.indirect.laws import DeployedLaws
from torchpi.control.indirect import TimeVaryingThresholdInverse, TimeVaryingThresholdPI, dilation
from torchpi.errors import ConfigError
from torchpi.operators import PrandtlIshlinskii
from torchpi.operators.conformance import OperatorLaws, wandering
from torchpi.operators.motion import Motion, backward_motion

R, RHO, W = [0.0, 0.4, 1.0, 2.0], [0.0, 3e-4, 3e-4, 3e-4], [0.8, 0.1, 0.2, 0.1]
GROWING = [0.0, 1e-4, 3e-4, 6e-4]


class TestForward(OperatorLaws):
    def operator(self) -> TimeVaryingThresholdPI:
        # ρ is chosen so that finite differences stay clear of the kinks at these rates.
        return TimeVaryingThresholdPI(0.1, [0.0, 0.11, 0.4], [1.0, 0.3, -0.2], [0.0, 0.013, 0.021])


class TestDeployed(DeployedLaws):
    def compensator(self) -> TimeVaryingThresholdInverse:
        return TimeVaryingThresholdInverse(1e-4, R, W, threshold_slopes=RHO)


@given(
    st.integers(0, 10_000),
    st.lists(st.floats(0.05, 2.0), min_size=4, max_size=4),
)
def test_the_inverse_is_exact_to_1e_9_if_the_condition_holds(seed: int, weights: list[float]) -> None:
    """Distances between the thresholds after the first stay or grow; the first itself rises and falls."""
    generator = torch.Generator().manual_seed(seed)
    x = 3 * wandering(1, 1500, seed)
    first = (1 + wandering(1, 1500, seed + 1)[0] / 2.5).clamp(min=0.0)
    gains = torch.rand(1500, 2, dtype=torch.float64, generator=generator).mul(2e-3).cumsum(0)
    r = torch.stack([torch.zeros_like(first), first, first + 0.2 + gains[:, 0], first + 1 + gains.sum(1)], 1)
    report = dilation(r)
    assert report.holds and "holds" in str(report)
    forward = TimeVaryingThresholdPI(1e-4, R, weights, RHO)
    inverse = TimeVaryingThresholdInverse(1e-4, R, weights, threshold_slopes=RHO)
    y, _ = forward.at_thresholds(x, r[None])
    assert (inverse.at_thresholds(y, r[None]) - x).abs().max() < 1e-9


def test_thresholds_that_shift_together_with_the_rate_satisfy_the_condition(motion: Motion) -> None:
    """r_i + ρ|u̇| with one ρ: distances are constant, and the round trip is exact as rates rise and fall."""
    forward, inverse = (
        kind(1e-4, R, W, threshold_slopes=RHO)
        for kind in (TimeVaryingThresholdPI, TimeVaryingThresholdInverse)
    )
    assert inverse.dilation(motion).holds
    r = forward.thresholds(motion.yd_dot)
    y, _ = forward.at_thresholds(motion.yd, r)
    assert (inverse.at_thresholds(y, r) - motion.yd).abs().max() < 1e-9
    assert (r.max(1).values - r.min(1).values)[:, 1:].min() > 0.05  # they do move


def test_a_failed_condition_is_reported_and_the_inverse_is_not_exact() -> None:
    """The last threshold approaches its neighbour and recedes again, independently of the input."""
    x = 3 * wandering(1, 1500, seed=5)
    still = torch.ones(1500, dtype=torch.float64)
    r = torch.stack([0 * still, 0.5 * still, 1.5 + wandering(1, 1500, seed=6)[0] / 2.5], 1)
    report = dilation(r)
    assert not report.holds
    assert 0.3 < report.violations / report.samples < 0.7
    assert report.plays == (1, 2) and report.largest_shrinkage > 0
    assert "fails" in str(report) and "plays 1 and 2" in str(report)
    forward = TimeVaryingThresholdPI(1e-4, R[:3], W[:3], RHO[:3])
    inverse = TimeVaryingThresholdInverse(1e-4, R[:3], W[:3], threshold_slopes=RHO[:3])
    y, _ = forward.at_thresholds(x, r[None])
    assert (inverse.at_thresholds(y, r[None]) - x).abs().max() > 1e-3


@pytest.mark.parametrize("tones", [[(4.0, 50.0)], [(2.0, 20.0), (1.2, 90.0)], [(3.0, 10.0), (1.0, 70.0)]])
def test_thresholds_that_are_smallest_at_every_reversal_need_no_dilation(tones: list) -> None:
    """r_i + ρ_i|u̇| with increasing ρ_i: the condition fails as the rate falls, but the inverse is exact."""
    t = 1e-4 * torch.arange(3000, dtype=torch.float64)[None]
    x = 5 - sum(a * torch.cos(2 * torch.pi * f * t) for a, f in tones)
    rate = sum(2 * torch.pi * f * a * torch.sin(2 * torch.pi * f * t) for a, f in tones)
    forward, inverse = (
        kind(1e-4, R, W, threshold_slopes=GROWING)
        for kind in (TimeVaryingThresholdPI, TimeVaryingThresholdInverse)
    )
    report = inverse.dilation(Motion(x, rate, rate))
    assert report.violations / report.samples == pytest.approx(0.5, abs=0.03)
    r = forward.thresholds(rate)
    y, _ = forward.at_thresholds(x, r)
    assert (inverse.at_thresholds(y, r) - x).abs().max() < 1e-9


def test_the_first_sample_that_violates_the_condition_is_reported() -> None:
    r = torch.tensor([[0.0, 1.0, 2.0]] * 5, dtype=torch.float64)
    r[3:, 2] = 1.75
    report = dilation(r)
    assert (report.first_sample, report.violations, report.largest_shrinkage) == (3, 1, 0.25)
    r[3:, 1] = 0.5  # the first threshold may shrink
    assert dilation(r).holds


def test_the_compensator_computes_the_thresholds_from_the_desired_rate(motion: Motion) -> None:
    inverse = TimeVaryingThresholdInverse(
        1e-4, R, W, threshold_slopes=RHO, min_voltage_v=-99, max_voltage_v=99
    )
    r = TimeVaryingThresholdPI(1e-4, R, W, RHO).thresholds(motion.yd_dot)
    assert torch.allclose(inverse(motion), inverse.at_thresholds(motion.yd, r), rtol=0, atol=1e-12)


def test_without_growth_it_is_eq_3() -> None:
    x = wandering(2, 300)
    assert torch.equal(TimeVaryingThresholdPI(1e-4, R, W, [0.0] * 4)(x)[0], PrandtlIshlinskii(R, W)(x)[0])


def test_the_forward_loop_grows_with_the_rate() -> None:
    forward, areas = TimeVaryingThresholdPI(1e-4, R, W, RHO), []
    for frequency_hz in (1, 10, 50):
        phase = 2 * torch.pi * torch.arange(2 * 10_000 // frequency_hz + 1, dtype=torch.float64)[None]
        x = 5 - 5 * torch.cos(phase * frequency_hz / 10_000)
        y, _ = forward.at_thresholds(x, forward.thresholds(backward_motion(x, 1e-4).yd_dot))
        half = x.shape[1] // 2
        areas.append(abs(torch.trapezoid(y[0, half:], x[0, half:]).item()))
    assert areas[0] < areas[1] < areas[2]


@pytest.mark.parametrize(
    ("rho", "named"),
    [
        ([1e-4, 1e-4, 1e-4, 1e-4], "threshold_slopes.*0 first"),
        ([0.0, 2e-4, 1e-4, 1e-4], "threshold_slopes.*non-decreasing"),
        ([0.0, 1e-4], "threshold_slopes.*expected 4"),
    ],
)
def test_thresholds_that_would_lose_their_order_are_refused(rho: list[float], named: str) -> None:
    for kind in (TimeVaryingThresholdPI, TimeVaryingThresholdInverse):
        with pytest.raises(ConfigError, match=named):
            kind(1e-4, R, W, threshold_slopes=rho)


def test_the_check_of_the_condition_refuses_thresholds_out_of_order() -> None:
    with pytest.raises(ConfigError, match="increasing order"):
        dilation(torch.tensor([[0.0, 2.0, 1.0]], dtype=torch.float64))
