"""Thermal drift: a function of the time since the recording began, independent of the motion."""

import math

import pytest
import torch

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.effect import DataRange
from torchpi.stage.effects.sensor.thermal_drift import ThermalDrift


class TestLaws(EffectLaws):
    def operator(self) -> ThermalDrift:
        return ThermalDrift(PERIOD_S, amplitude_um=0.4, time_constant_s=7.0, rate_um_per_s=-0.01)


def test_the_drift_settles_at_its_amplitude_or_continues_at_its_rate():
    x = wandering(1, 1001)
    moved = (ThermalDrift(0.1, amplitude_um=2.0, time_constant_s=5.0)(x)[0] - x)[0]
    assert moved[0].item() == 0
    assert moved[50].item() == pytest.approx(2 * (1 - math.exp(-1)), rel=1e-9)
    assert moved[-1].item() == pytest.approx(2.0, rel=1e-6)
    moved = (ThermalDrift(0.1, rate_um_per_s=0.03)(x)[0] - x)[0]
    torch.testing.assert_close(moved, 0.003 * torch.arange(1001, dtype=torch.float64), rtol=0, atol=1e-12)


def test_the_forms_in_use_are_named():
    assert ThermalDrift.form({"time_constant_s": 3.0}) == ""
    assert ThermalDrift.form({"rate_um_per_s": 1.0}) == "linear"
    assert ThermalDrift.form({"amplitude_um": 1.0, "rate_um_per_s": 0.2}) == "exponential + linear"


def test_a_search_tries_a_ramp_and_time_constants_up_to_the_duration():
    starts = ThermalDrift.starts(DataRange(1e3, 50.0, 0, 1, 1, 0, 20, {}))
    assert starts[0] == {"rate_um_per_s": pytest.approx(0.2 / 50)}
    assert [start["time_constant_s"] for start in starts[1:]] == [2.5, 10.0, 50.0]
    assert [ThermalDrift.form(start) for start in starts] == ["linear", *["exponential"] * 3]


@pytest.mark.parametrize("duration_s", [0.05, 50.0])
def test_settling_within_a_hundredth_of_a_recording_does_not_count_as_drift(duration_s: float):
    seen = DataRange(1e3, duration_s, 0, 1, 1, 0, 20, {})
    assert not ThermalDrift.reached({"time_constant_s": 0.009 * duration_s}, seen)
    assert ThermalDrift.reached({"rate_um_per_s": 1.0}, seen)
    assert all(ThermalDrift.reached(start, seen) for start in ThermalDrift.starts(seen))
