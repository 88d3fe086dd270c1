"""Hum: a line of the mains whose phase follows the clock of the recording."""

import math

import pytest
import torch

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.effect import DataRange
from torchpi.stage.effects.sensor.hum import Hum


class TestLaws(EffectLaws):
    def operator(self) -> Hum:
        sizes = {
            "cos_um": 0.3,
            "sin_um": -0.2,
            "cos2_um": 0.1,
            "sin2_um": 0.05,
            "cos3_um": 0.02,
            "sin3_um": -0.1,
        }
        return Hum(PERIOD_S, frequency_hz=50.7, **sizes)


def test_the_spectrum_shows_one_line_of_the_given_amplitude_and_phase():
    time, period_s = 1000, 1e-3
    y = Hum(period_s, frequency_hz=60.0, cos_um=0.02, sin_um=0.05)(torch.zeros(1, time, dtype=torch.float64))[
        0
    ]
    lines = torch.fft.rfft(y[0].detach()) / (time / 2)
    assert lines[60].real.item() == pytest.approx(0.02) and lines[60].imag.item() == pytest.approx(-0.05)
    lines[60] = 0
    assert lines.abs().max().item() < 1e-12


def test_the_line_is_still_in_phase_after_an_hour():
    elapsed = torch.full((1, 1), 3600 * 10_000.0, dtype=torch.float64)
    effect = Hum(1e-4, frequency_hz=50.0, cos_um=1.0)
    y, after = effect(torch.zeros(1, 200, dtype=torch.float64), elapsed)
    wanted = torch.cos(2 * math.pi * 50 * 1e-4 * torch.arange(200, dtype=torch.float64))
    torch.testing.assert_close(y[0], wanted, rtol=0, atol=1e-8)
    assert after.item() == 3600 * 10_000 + 200


def test_each_row_has_the_phase_of_its_own_elapsed_time():
    x, elapsed = wandering(2, 50), torch.tensor([[0.0], [7.0]], dtype=torch.float64)
    effect = Hum(1e-3, frequency_hz=50.0, cos_um=0.1, sin_um=0.2)
    whole = effect(torch.zeros(1, 57, dtype=torch.float64))[0][0]
    line = effect(x, elapsed)[0] - x
    torch.testing.assert_close(line, torch.stack([whole[:50], whole[7:]]), rtol=0, atol=1e-15)


def test_a_search_starts_at_lines_below_half_the_sample_rate():
    starts = Hum.starts(DataRange(350.0, 1.0, 0, 1, 1, 0, 10, {}))
    lines = [start["frequency_hz"] for start in starts if Hum.form(start) == "one line"]
    with_harmonics = [start["frequency_hz"] for start in starts if Hum.form(start) == "with harmonics"]
    assert lines == [50.0, 60.0, 100.0, 120.0, 150.0] and with_harmonics == [50.0]
