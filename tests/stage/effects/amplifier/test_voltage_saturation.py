"""Voltage saturation: constant beyond the limits of the supply."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws, fixed
from torchpi.errors import StageError
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.amplifier.voltage_saturation import VoltageSaturation
from torchpi.stage.effects.effect import DataRange


class TestHardLaws(EffectLaws):
    def operator(self) -> VoltageSaturation:
        return fixed(VoltageSaturation(PERIOD_S, low_v=-0.8, high_v=1.1), "knee_v")

    def test_saved_parameters_are_valid_at_any_sample_rate(self):
        x, fast = wandering(1, 50), VoltageSaturation(PERIOD_S / 10, low_v=-0.8, high_v=1.1)
        assert torch.equal(fast(x)[0], self.operator()(x)[0])


class TestSoftLaws(EffectLaws):
    def operator(self) -> VoltageSaturation:
        return VoltageSaturation(PERIOD_S, low_v=-0.8, high_v=1.1, knee_v=0.2)

    def test_saved_parameters_are_valid_at_any_sample_rate(self):
        x, fast = wandering(1, 50), VoltageSaturation(PERIOD_S / 10, low_v=-0.8, high_v=1.1, knee_v=0.2)
        assert torch.equal(fast(x)[0], self.operator()(x)[0])


def test_a_soft_limit_has_half_the_slope_at_the_limit_and_is_hard_far_from_it():
    effect = VoltageSaturation(0.1, low_v=-5.0, high_v=3.0, knee_v=0.1)
    x = torch.tensor([[-50.0, -3.0, 0.0, 1.0, 3.0, 50.0]], dtype=torch.float64, requires_grad=True)
    v = effect(x)[0]
    v.sum().backward()
    assert v[0].tolist() == pytest.approx([-5, -3, 0, 1, 3 - 0.1 * math.log(2), 3], abs=1e-8)
    assert x.grad[0].tolist() == pytest.approx([0, 1, 1, 1, 0.5, 0], abs=1e-8)


@given(x=st.floats(-1e3, 1e3), low=st.floats(-100, -1), high=st.floats(1, 100), knee=st.floats(1e-6, 50))
def test_a_soft_limit_rises_with_the_command_and_stays_between_its_limits(x, low, high, knee):
    effect = VoltageSaturation(0.1, low_v=low, high_v=high, knee_v=knee)
    a, b = effect(torch.tensor([[x, x + 1.0]], dtype=torch.float64))[0][0].tolist()
    assert a <= b <= high + knee * math.log1p(math.exp((low - high) / knee)) + 1e-9
    assert a >= low


def test_a_soft_limit_must_lie_within_the_commands_and_leave_a_linear_part():
    seen = DataRange(1e3, 1.0, -2.0, 8.0, 1, 0, 1, {})
    for high_v, knee_v, reached in ((7.0, 0.5, True), (9.0, 0.5, False), (7.0, 5.0, False)):
        assert VoltageSaturation.reached({"high_v": high_v, "knee_v": knee_v}, seen) is reached
    assert VoltageSaturation.reached({"high_v": 9.0}, seen)


def test_clipped_samples_pass_their_gradient_to_the_limit():
    effect = VoltageSaturation(0.1, low_v=-2.0, high_v=12.0)
    x = torch.tensor([[-3.0, -2.5, 0.5, 11.0, 13.0]], dtype=torch.float64, requires_grad=True)
    v = effect(x)[0]
    assert v.tolist() == [[-2.0, -2.0, 0.5, 11.0, 12.0]]
    v.sum().backward()
    assert x.grad.tolist() == [[0.0, 0.0, 1.0, 1.0, 0.0]]
    assert (effect.low_v.grad.item(), effect.high_v.grad.item()) == (2.0, 1.0)


def test_one_limit_may_be_missing():
    effect, x = VoltageSaturation(0.1, high_v=0.5), wandering(1, 100)
    assert torch.equal(effect(x)[0], x.clamp(max=0.5)) and effect.low_v.item() == -math.inf


def test_limits_out_of_order_are_refused():
    with pytest.raises(StageError, match="high_v: found 1 V, expected more than low_v = 2 V"):
        VoltageSaturation(0.1, low_v=2.0, high_v=1.0)


def test_a_search_tries_either_limit_and_both_each_hard_and_soft():
    starts = VoltageSaturation.starts(DataRange(1e3, 1.0, -2.0, 8.0, 1, 0, 1, {}))
    limits = [{"high_v"}, {"low_v"}, {"low_v", "high_v"}]
    assert {frozenset(start) for start in starts} == {
        frozenset(each | knee) for each in limits for knee in (set(), {"knee_v"})
    }
    assert starts[0]["high_v"] == pytest.approx(7.95)
