"""Gain modulation: a slow signal, not driven by the voltage, that scales or shifts the displacement."""

import math

import numpy as np
import pytest
import torch

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.effect import DataRange
from torchpi.stage.effects.sensor.gain_modulation import GainModulation, lines_hz, modulation_hz

SEEN = DataRange(1e3, 20.0, 0, 1, 1, 0, 20, {})


class TestLaws(EffectLaws):
    def operator(self) -> GainModulation:
        return GainModulation(PERIOD_S, frequency_hz=0.7, cos=0.1, sin=-0.2, cos_um=0.3, sin_um=0.05)


def test_the_gain_is_modulated_at_one_frequency():
    x = wandering(1, 400)
    y = GainModulation(0.01, frequency_hz=3.0, cos=0.02, sin=-0.01)(x)[0]
    phase = 2 * math.pi * 3.0 * 0.01 * torch.arange(400, dtype=torch.float64)
    expected = x * (1 + 0.02 * phase.cos() - 0.01 * phase.sin())
    torch.testing.assert_close(y, expected, rtol=0, atol=1e-12)


def test_only_the_additive_form_moves_a_stage_at_zero():
    x = torch.zeros(1, 100, dtype=torch.float64)
    assert torch.equal(GainModulation(0.01, cos=0.1)(x)[0], x)
    assert GainModulation(0.01, cos_um=0.1)(x)[0][0, 0].item() == pytest.approx(0.1)


def test_recordings_have_their_own_amplitude_and_phase_but_share_the_frequency():
    assert "frequency_hz" not in GainModulation.per_recording
    assert {"cos", "sin", "cos_um", "sin_um"} == {*GainModulation.per_recording}


def test_every_start_has_one_form_and_every_form_has_a_start():
    forms = [GainModulation.form(start) for start in GainModulation.starts(SEEN)]
    assert set(forms) == set(GainModulation.forms)


def test_a_search_starts_at_lines_of_at_least_two_periods_below_half_the_sample_rate():
    lines = {s["frequency_hz"] for s in GainModulation.starts(SEEN) if "frequency_hz" in s}
    assert lines == {0.2, 0.6, 2.0, 6.0, 20.0}
    slow = DataRange(10.0, 20.0, 0, 1, 1, 0, 20, {})
    assert max(s.get("frequency_hz", 0.0) for s in GainModulation.starts(slow)) == 2.0
    assert GainModulation.starts(DataRange(1e3, 0.1, 0, 1, 1, 0, 20, {})) == []


def test_given_lines_that_are_too_slow_or_too_fast_are_left_out():
    found = {s["frequency_hz"] for s in GainModulation.starts_at(SEEN, [1e-3, 3.1, 50.0], [7.0])}
    assert found == {3.1, 7.0}


@pytest.mark.parametrize("frequency_hz", [0.31, 3.07, 17.3])
def test_the_frequency_of_a_modulation_is_found_in_the_residual(frequency_hz):
    t = np.arange(10_000) / 1e3
    x = 10 + 8 * np.sin(2 * np.pi * 1.7 * t) * np.cos(2 * np.pi * 0.23 * t)
    e = 0.01 * x * np.cos(2 * np.pi * frequency_hz * t + 0.4) + 0.03 * x
    e += 0.02 * np.random.default_rng(0).standard_normal(len(t))
    lines = modulation_hz(e, x, 1e3)
    assert lines[0] == pytest.approx(frequency_hz, abs=0.25 / 10)
    assert len(lines) <= 4 and len(modulation_hz(e, x, 1e3, count=2)) <= 2


def test_a_line_is_found_in_the_residual_between_larger_lines_of_the_command():
    t = np.arange(12_000) / 1e3
    rng = np.random.default_rng(0)
    phase, lines = rng.uniform(0, 6, 20), np.arange(1, 21) * 11 / 12
    x = np.sum([np.cos(2 * np.pi * f * t + p) for f, p in zip(lines, phase, strict=True)], axis=0)
    e = 0.1 * np.roll(x, 30) + 0.03 * np.cos(2 * np.pi * 0.37 * t) + rng.normal(0, 0.02, len(t))
    assert lines_hz(e, x, 1e3)[0] == pytest.approx(0.37, abs=0.25 / 12)
    assert len(lines_hz(e, x, 1e3, count=1)) == 1
