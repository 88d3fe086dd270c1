"""Amplifier lag: a first-order lag of a held command."""

import math

import numpy as np
import scipy.signal
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.amplifier.amplifier_lag import AmplifierLag
from torchpi.stage.effects.effect import Seen


class TestLaws(EffectLaws):
    def operator(self) -> AmplifierLag:
        return AmplifierLag(PERIOD_S, cutoff_hz=1.3)

    def test_saved_parameters_serve_any_sample_rate(self):
        held = wandering(1, 200)
        fine = AmplifierLag(PERIOD_S / 10, cutoff_hz=1.3)(held.repeat_interleave(10, 1))[0][:, 9::10]
        torch.testing.assert_close(fine, self.operator()(held)[0], rtol=0, atol=1e-12)


@given(cutoff_hz=st.floats(1.0, 1e4), fs_hz=st.sampled_from([100.0, 1e4, 1e6]))
def test_a_step_settles_as_one_exponential(cutoff_hz, fs_hz):
    y = AmplifierLag(1 / fs_hz, cutoff_hz=cutoff_hz)(torch.ones(1, 50, dtype=torch.float64))[0][0]
    t = torch.arange(1, 51, dtype=torch.float64) / fs_hz
    torch.testing.assert_close(y.detach(), -torch.expm1(-2 * math.pi * cutoff_hz * t), rtol=0, atol=1e-12)


def test_it_is_the_low_pass_that_scipy_simulates_for_a_held_command():
    x, omega = wandering(1, 200), 2 * math.pi * 20.0
    _, wanted, _ = scipy.signal.lsim(
        ([omega], [1.0, omega]), np.r_[x[0].numpy(), 0.0], 0.01 * np.arange(201), interp=False
    )
    y = AmplifierLag(0.01, cutoff_hz=20.0)(x)[0][0].detach().numpy()
    np.testing.assert_allclose(y, wanted[1:], rtol=0, atol=1e-11)


def test_a_search_starts_below_a_third_of_the_sample_rate():
    cutoffs = [start["cutoff_hz"] for start in AmplifierLag.starts(Seen(2e3, 1.0, 0, 1, 1, 0, 1, {}))]
    assert cutoffs == [16.0, 60.0, 200.0]
