"""Ageing: the gain falls with time or with travel."""

import math

import pytest
import torch

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws, step
from torchpi.stage.effects.actuator.ageing import Ageing
from torchpi.stage.effects.effect import DataRange


class TestLaws(EffectLaws):
    def operator(self) -> Ageing:
        return Ageing(PERIOD_S, loss_per_s=0.02, loss_per_mm=30.0, exponent=1.3)


def test_the_gain_falls_exponentially_with_time_at_a_constant_input():
    y = Ageing(0.1, loss_per_s=0.01)(3 * step(1001))[0][0]
    assert y[0].item() == 3
    assert y[1000].item() == pytest.approx(3 * math.exp(-0.01 * 100), rel=1e-12)


def test_the_gain_falls_with_travel_and_stays_constant_during_a_hold():
    cycle = torch.tensor([2.0, 0.0, -2.0, 0.0], dtype=torch.float64)  # 8 µm of travel per cycle
    x = torch.cat([cycle.repeat(100), torch.full((500,), 2.0, dtype=torch.float64)])[None]
    y = Ageing(0.1, loss_per_mm=0.5)(x)[0][0]
    assert y[400].item() == pytest.approx(2 * math.exp(-0.5 * (100 * 8 + 2) * 1e-3), rel=1e-12)
    assert y[-1].item() == y[400].item()


def test_a_search_starts_at_a_loss_of_one_per_cent_over_the_recording():
    by_time, bent, by_travel = Ageing.starts(DataRange(1e4, 20.0, 0.0, 10.0, 100.0, 0.0, 50.0, {}))
    assert by_time == {"loss_per_s": 0.01 / 20}
    assert bent == {"loss_per_s": 0.01 / 20, "exponent": 1.0}
    assert by_travel == {"loss_per_mm": pytest.approx(0.01 / 2.5)}  # 500 µm/s at most, 125 on average


def test_the_exponent_gives_a_stretched_or_compressed_exponential():
    t = torch.arange(1001, dtype=torch.float64) * 0.1
    for exponent in (0.5, 2.0):
        y = Ageing(0.1, loss_per_s=0.01, exponent=exponent)(3 * step(1001))[0][0]
        torch.testing.assert_close(y, 3 * torch.exp(-((0.01 * t) ** exponent)), rtol=1e-12, atol=0)
