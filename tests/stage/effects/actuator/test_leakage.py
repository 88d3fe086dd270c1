"""Leakage is the first-order high-pass of a charge drive."""

import math

import numpy as np
import pytest
import scipy.signal
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws, step
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.actuator.leakage import Leakage


class TestLaws(EffectLaws):
    def operator(self) -> Leakage:
        return Leakage(PERIOD_S, corner_hz=0.2)


@given(corner_hz=st.floats(0.003, 5.0))
def test_the_response_matches_the_high_pass_simulated_by_scipy(corner_hz):
    period_s, x = 0.05, wandering(1, 200)
    omega = 2 * math.pi * corner_hz
    _, wanted, _ = scipy.signal.lsim(([1.0, 0.0], [1.0, omega]), x[0].numpy(), period_s * np.arange(200))
    y = Leakage(period_s, corner_hz=corner_hz)(x)[0][0].detach().numpy()
    np.testing.assert_allclose(y, wanted, rtol=0, atol=1e-12)


def test_a_held_displacement_decays_to_zero_with_the_time_constant_of_the_corner():
    y = Leakage(1e-2, corner_hz=0.1)(step(3001))[0][0]
    assert (y[1000] / y[0]).item() == pytest.approx(math.exp(-2 * math.pi * 0.1 * 10), rel=1e-9)
    assert abs(y[-1].item()) < 1e-8


def test_a_corner_far_below_the_sample_rate_loses_no_precision():
    y = Leakage(1e-6, corner_hz=0.003)(step(1001))[0][0]
    lost = 1 - torch.exp(-2 * math.pi * 0.003e-6 * (torch.arange(1001, dtype=torch.float64) + 0.5))
    torch.testing.assert_close(1 - y.detach(), lost, rtol=1e-4, atol=1e-15)
