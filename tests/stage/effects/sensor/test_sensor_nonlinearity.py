"""Sensor nonlinearity: a memoryless polynomial of the displacement."""

import pytest
import torch

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws
from torchpi.stage.effects.effect import DataRange
from torchpi.stage.effects.sensor.sensor_nonlinearity import SensorNonlinearity


class TestLaws(EffectLaws):
    def operator(self) -> SensorNonlinearity:
        return SensorNonlinearity(PERIOD_S, a2_per_um=0.05, a3_per_um2=-0.02)


def test_the_reading_is_a_cubic_polynomial_of_the_displacement():
    x = torch.linspace(-3, 5, 50, dtype=torch.float64)[None]
    y = SensorNonlinearity(1e-4, a2_per_um=0.02, a3_per_um2=0.001)(x)[0]
    torch.testing.assert_close(y, x + 0.02 * x**2 + 0.001 * x**3, rtol=0, atol=1e-14)


def test_a_search_starts_at_one_per_cent_of_full_range():
    for start in SensorNonlinearity.starts(DataRange(1e4, 1.0, 0.0, 8.0, 1.0, -10.0, 30.0, {})):
        y = SensorNonlinearity(1e-4, **start)(torch.full((1, 1), 40.0, dtype=torch.float64))[0]
        assert y.item() == pytest.approx(40 * (1 + 0.01 * len(start)), rel=1e-12)
