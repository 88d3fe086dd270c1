"""Amplifier lag: one pole or two that act on a held command."""

import math
from itertools import pairwise

import numpy as np
import pytest
import scipy.signal
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws, fixed
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.amplifier.amplifier_lag import AmplifierLag
from torchpi.stage.effects.effect import DataRange


class TestOnePoleLaws(EffectLaws):
    def operator(self) -> AmplifierLag:
        return fixed(AmplifierLag(PERIOD_S, cutoff_hz=1.3), "damping_ratio")

    def test_saved_parameters_are_valid_at_any_sample_rate(self):
        held = wandering(1, 200)
        fine = AmplifierLag(PERIOD_S / 10, cutoff_hz=1.3)(held.repeat_interleave(10, 1))[0][:, 9::10]
        torch.testing.assert_close(fine, self.operator()(held)[0], rtol=0, atol=1e-12)


class TestTwoPolesLaws(EffectLaws):
    def operator(self) -> AmplifierLag:
        return AmplifierLag(PERIOD_S, cutoff_hz=1.3, damping_ratio=0.6)

    def test_saved_parameters_are_valid_at_any_sample_rate(self):
        held = wandering(1, 200)
        fine = AmplifierLag(PERIOD_S / 10, cutoff_hz=1.3, damping_ratio=0.6)(held.repeat_interleave(10, 1))[0]
        torch.testing.assert_close(fine[:, 9::10], self.operator()(held)[0], rtol=0, atol=1e-11)


@given(cutoff_hz=st.floats(1.0, 1e4), fs_hz=st.sampled_from([100.0, 1e4, 1e6]))
def test_a_step_settles_as_one_exponential(cutoff_hz, fs_hz):
    y = AmplifierLag(1 / fs_hz, cutoff_hz=cutoff_hz)(torch.ones(1, 50, dtype=torch.float64))[0][0]
    t = torch.arange(1, 51, dtype=torch.float64) / fs_hz
    torch.testing.assert_close(y.detach(), -torch.expm1(-2 * math.pi * cutoff_hz * t), rtol=0, atol=1e-12)


def test_one_pole_matches_the_low_pass_simulated_by_scipy_for_a_held_command():
    x, omega = wandering(1, 200), 2 * math.pi * 20.0
    _, wanted, _ = scipy.signal.lsim(
        ([omega], [1.0, omega]), np.r_[x[0].numpy(), 0.0], 0.01 * np.arange(201), interp=False
    )
    y = AmplifierLag(0.01, cutoff_hz=20.0)(x)[0][0].detach().numpy()
    np.testing.assert_allclose(y, wanted[1:], rtol=0, atol=1e-11)


@pytest.mark.parametrize("damping_ratio", [0.4, 0.7, 1.0, 3.0])
def test_two_poles_match_the_low_pass_simulated_by_scipy_for_a_held_command(damping_ratio):
    x, omega = wandering(1, 200), 2 * math.pi * 20.0
    transfer = ([1.0], [1 / (2 * damping_ratio * omega) ** 2, 1 / omega, 1.0])
    _, expected, _ = scipy.signal.lsim(
        transfer, np.r_[x[0].numpy(), 0.0], 0.01 * np.arange(201), interp=False
    )
    y = AmplifierLag(0.01, cutoff_hz=20.0, damping_ratio=damping_ratio)(x)[0][0].detach().numpy()
    np.testing.assert_allclose(y, expected[1:], rtol=0, atol=1e-9)


@given(
    cutoff_hz=st.floats(1.0, 1e6),
    damping_ratio=st.floats(0.35, 10.0),
    fs_hz=st.sampled_from([10.0, 1e4, 1e6]),
)
def test_two_poles_settle_at_the_command_however_fast_they_are(cutoff_hz, damping_ratio, fs_hz):
    samples = int(min(20 * fs_hz / cutoff_hz, 2e4)) + 5
    y = AmplifierLag(1 / fs_hz, cutoff_hz=cutoff_hz, damping_ratio=damping_ratio)(
        torch.ones(1, samples, dtype=torch.float64)
    )[0]
    if samples > 20 * fs_hz / cutoff_hz:
        assert y[0, -1].item() == pytest.approx(1.0, abs=1e-6)


def test_with_much_damping_two_poles_act_like_one():
    x = wandering(1, 300)
    one, two = (AmplifierLag(0.01, cutoff_hz=2.0, **more)(x)[0] for more in ({}, {"damping_ratio": 10.0}))
    assert (two - one).abs().max().item() < 0.01 * one.abs().max().item()


def test_the_form_states_the_number_of_poles():
    assert AmplifierLag.form({}) == ""
    assert AmplifierLag.form({"cutoff_hz": 20.0}) == "one pole"
    assert AmplifierLag.form({"cutoff_hz": 20.0, "damping_ratio": 1.0}) == "two poles"


@pytest.mark.parametrize(("fs_hz", "duration_s"), [(200.0, 130.0), (2e3, 1.0), (5e4, 0.05)])
def test_search_starts_span_one_over_the_duration_to_a_third_of_the_sample_rate(
    fs_hz: float, duration_s: float
) -> None:
    starts = AmplifierLag.starts(DataRange(fs_hz, duration_s, 0, 1, 1, 0, 1, {}))
    one = [start["cutoff_hz"] for start in starts if "damping_ratio" not in start]
    assert [start["cutoff_hz"] for start in starts if "damping_ratio" in start] == one
    assert max(one) == fs_hz / 3 and 1 <= min(one) * duration_s < 4
    assert all(later / earlier == pytest.approx(1 / 3.6) for earlier, later in pairwise(one))
