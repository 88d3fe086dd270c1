"""Input nonlinearity: a memoryless polynomial of the voltage."""

import math

import pytest
import torch

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws
from torchpi.stage.effects.actuator.input_nonlinearity import InputNonlinearity
from torchpi.stage.effects.effect import DataRange


class TestLaws(EffectLaws):
    def operator(self) -> InputNonlinearity:
        return InputNonlinearity(PERIOD_S, c2_per_v=0.05, c3_per_v2=-0.02)


def test_a_cosine_acquires_the_harmonics_of_its_square_and_cube():
    turn = 2 * math.pi * torch.arange(64, dtype=torch.float64) / 64
    y = InputNonlinearity(1e-4, c2_per_v=0.1, c3_per_v2=0.04)(2 * torch.cos(turn)[None])[0][0]
    lines = torch.fft.rfft(y).real / 32
    assert lines[2].item() == pytest.approx(0.1 * 2**2 / 2, rel=1e-12)
    assert lines[3].item() == pytest.approx(0.04 * 2**3 / 4, rel=1e-12)


def test_a_search_starts_at_one_per_cent_of_full_voltage():
    for start in InputNonlinearity.starts(DataRange(1e4, 1.0, 0.0, 8.0, 1.0, 0.0, 1.0, {})):
        y = InputNonlinearity(1e-4, **start)(torch.full((1, 1), 8.0, dtype=torch.float64))[0]
        assert y.item() == pytest.approx(8 * (1 + 0.01 * len(start)), rel=1e-12)


def test_it_acts_on_the_voltage_before_the_hysteresis():
    assert InputNonlinearity.before_hysteresis
