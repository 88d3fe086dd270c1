"""Voltage saturation: flat beyond the supply."""

import math

import pytest
import torch

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws
from torchpi.errors import StageError
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.amplifier.voltage_saturation import VoltageSaturation
from torchpi.stage.effects.effect import DataRange


class TestLaws(EffectLaws):
    def operator(self) -> VoltageSaturation:
        return VoltageSaturation(PERIOD_S, low_v=-0.8, high_v=1.1)

    def test_saved_parameters_serve_any_sample_rate(self):
        x, fast = wandering(1, 50), VoltageSaturation(PERIOD_S / 10, low_v=-0.8, high_v=1.1)
        assert torch.equal(fast(x)[0], self.operator()(x)[0])


def test_a_limit_takes_the_gradient_of_what_it_holds():
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


def test_a_search_tries_either_limit_and_both():
    starts = VoltageSaturation.starts(DataRange(1e3, 1.0, -2.0, 8.0, 1, 0, 1, {}))
    assert {frozenset(start) for start in starts} == {
        frozenset({"high_v"}),
        frozenset({"low_v"}),
        frozenset({"low_v", "high_v"}),
    }
    assert starts[0]["high_v"] == pytest.approx(7.95)
