"""Sensor lag: one pole or two, for a signal that is linear between samples."""

import math

import numpy as np
import pytest
import scipy.signal
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws, fixed
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.effect import DataRange
from torchpi.stage.effects.sensor.sensor_lag import SensorLag


class TestOnePoleLaws(EffectLaws):
    def operator(self) -> SensorLag:
        return fixed(SensorLag(PERIOD_S, cutoff_hz=1.3), "damping_ratio")


class TestTwoPolesLaws(EffectLaws):
    def operator(self) -> SensorLag:
        return SensorLag(PERIOD_S, cutoff_hz=1.3, damping_ratio=0.6)


def test_at_the_cutoff_the_gain_is_down_by_3_db_and_the_phase_is_minus_45_degrees():
    fs_hz, cutoff_hz = 50_000.0, 200.0
    t = torch.arange(25_000, dtype=torch.float64) / fs_hz
    y, _ = SensorLag(1 / fs_hz, cutoff_hz=cutoff_hz)(torch.sin(2 * math.pi * cutoff_hz * t)[None])
    steady = slice(12_500, None)
    line = torch.exp(-2j * math.pi * cutoff_hz * t[steady])
    response = 2j * (y[0, steady].detach() * line).mean()
    assert abs(response) == pytest.approx(1 / math.sqrt(2), rel=1e-4)
    assert torch.angle(response).item() == pytest.approx(-math.pi / 4, abs=1e-4)


@given(cutoff_hz=st.floats(1.0, 100.0))
def test_one_pole_matches_the_low_pass_simulated_by_scipy(cutoff_hz):
    period_s, x, omega = 0.01, wandering(1, 200), 2 * math.pi * cutoff_hz
    _, wanted, _ = scipy.signal.lsim(([omega], [1.0, omega]), x[0].numpy(), period_s * np.arange(200))
    y = SensorLag(period_s, cutoff_hz=cutoff_hz)(x)[0][0].detach().numpy()
    np.testing.assert_allclose(y, wanted, rtol=0, atol=1e-11)


@given(cutoff_hz=st.floats(1.0, 100.0), damping_ratio=st.floats(0.35, 3.0))
def test_two_poles_match_the_low_pass_simulated_by_scipy(cutoff_hz, damping_ratio):
    period_s, x, omega = 0.01, wandering(1, 200), 2 * math.pi * cutoff_hz
    transfer = ([1.0], [1 / (2 * damping_ratio * omega) ** 2, 1 / omega, 1.0])
    _, expected, _ = scipy.signal.lsim(transfer, x[0].numpy(), period_s * np.arange(200))
    y = SensorLag(period_s, cutoff_hz=cutoff_hz, damping_ratio=damping_ratio)(x)[0][0].detach().numpy()
    np.testing.assert_allclose(y, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("cutoff_hz", [60.0, 1e3, 1e6])
def test_a_cutoff_above_half_the_sample_rate_gives_a_small_lag_and_a_finite_gradient(cutoff_hz):
    x = wandering(1, 300)
    effect = SensorLag(0.01, cutoff_hz=cutoff_hz)
    y = effect(x)[0]
    lag_s = 1 / (2 * math.pi * cutoff_hz)
    slope = torch.diff(x, dim=1).abs().max() / 0.01
    assert bool(((y - x).abs() <= 1.01 * lag_s * slope).all())
    y.square().sum().backward()
    assert bool(effect.cutoff_hz.grad.isfinite())


def test_search_starts_lie_between_one_over_the_duration_and_half_the_sample_rate():
    cutoffs = [start["cutoff_hz"] for start in SensorLag.starts(DataRange(10e3, 1.0, 0, 1, 1, 0, 1, {}))]
    assert max(cutoffs) == 4500.0 and 1.0 <= min(cutoffs) < 4.0
