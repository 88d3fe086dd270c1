"""First-order lags: in the chain, and of a held and delayed command."""

import math

import numpy as np
import pytest
import scipy.signal
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchpi.errors import StageError
from torchpi.operators.conformance import OperatorLaws, wandering
from torchpi.operators.held_lag import HeldLag
from torchpi.operators.lag import Lag


class TestLagLaws(OperatorLaws):
    def operator(self) -> Lag:
        return Lag(sample_period_s=0.1, cutoff_hz=1.3)


class TestHeldLagLaws(OperatorLaws):
    def operator(self) -> HeldLag:
        return HeldLag(sample_period_s=0.1, cutoff_hz=1.3, delay_s=0.237)


class TestIdealHeldLagLaws(OperatorLaws):
    def operator(self) -> HeldLag:
        return HeldLag(sample_period_s=0.1, delay_s=0.237)


def test_gain_at_the_cutoff_is_three_decibels_down_and_phase_an_eighth_of_a_turn():
    fs_hz, cutoff_hz = 50_000.0, 200.0
    t = torch.arange(25_000, dtype=torch.float64) / fs_hz
    y, _ = Lag(1 / fs_hz, cutoff_hz)(torch.sin(2 * math.pi * cutoff_hz * t)[None])
    steady = slice(12_500, None)
    line = torch.exp(-2j * math.pi * cutoff_hz * t[steady])
    response = 2j * (y[0, steady].detach() * line).mean()
    assert abs(response) == pytest.approx(1 / math.sqrt(2), rel=1e-4)
    assert torch.angle(response).item() == pytest.approx(-math.pi / 4, abs=1e-4)


@given(parts=st.integers(0, 350), cutoff_hz=st.floats(0.2, 20.0))
def test_held_lag_is_exact_for_any_delay_in_whole_and_parts_of_a_sample(parts, cutoff_hz):
    period_s, fine = 0.1, 100  # delays are multiples of a hundredth of a sample, up to 3.5 samples
    u = wandering(1, 30)
    held = np.r_[np.zeros(parts), np.repeat(u[0].numpy(), fine)]
    times = period_s / fine * np.arange(len(held))
    omega = 2 * math.pi * cutoff_hz
    _, wanted, _ = scipy.signal.lsim(([[-omega]], [[omega]], [[1.0]], [[0.0]]), held, times, interp=False)
    v, _ = HeldLag(period_s, cutoff_hz, delay_s=parts / fine * period_s)(u)
    np.testing.assert_allclose(v[0].detach().numpy(), wanted[: 30 * fine : fine], rtol=0, atol=1e-10)


def test_a_held_lag_serves_any_sample_rate():
    u = wandering(1, 50)
    slow, _ = HeldLag(1e-4, 2000.0, delay_s=1.3e-4)(u)
    fast, _ = HeldLag(1e-5, 2000.0, delay_s=1.3e-4)(u.repeat_interleave(10, 1))
    torch.testing.assert_close(fast[:, ::10], slow, rtol=0, atol=1e-12)


def test_voltage_at_a_tick_does_not_depend_on_the_command_of_that_tick():
    u = wandering(1, 20)
    for lag in (HeldLag(1e-4), HeldLag(1e-4, 2000.0, 3e-5)):
        altered = u.clone()
        altered[:, 10] += 1
        assert torch.equal(lag(altered)[0][:, :11], lag(u)[0][:, :11])
        assert not torch.equal(lag(altered)[0][:, 11], lag(u)[0][:, 11])


def test_ideal_held_lag_gives_the_command_before():
    u = wandering(2, 20)
    v, _ = HeldLag(1e-4)(u)
    assert torch.equal(v[:, 1:], u[:, :-1]) and bool((v[:, 0] == 0).all())


def test_delay_can_be_learnt_through_whole_samples():
    u = wandering(1, 400)
    wanted = HeldLag(1e-4, 1500.0, delay_s=3.4e-4)(u)[0].detach()
    lag = HeldLag(1e-4, 1500.0, delay_s=0.7e-4)
    for _ in range(60):  # Gauss–Newton in the one unknown
        error = lag(u)[0] - wanted
        (slope,) = torch.autograd.grad((error.detach() * error).sum(), lag.delay_s)
        probe = HeldLag(1e-4, 1500.0, lag.delay_s.item() + 1e-9)(u)[0].detach()
        curvature = (((probe - wanted - error.detach()) / 1e-9) ** 2).sum()
        with torch.no_grad():
            lag.delay_s -= slope / curvature
    assert lag.delay_s.item() == pytest.approx(3.4e-4, rel=1e-6)


@pytest.mark.parametrize("cutoff_hz", [0.0, -1.0, math.inf, math.nan])
def test_a_cutoff_must_be_positive(cutoff_hz):
    for make in (lambda: Lag(1e-4, cutoff_hz), lambda: HeldLag(1e-4, cutoff_hz)):
        with pytest.raises(StageError, match=r"cutoff_hz: found .* want a positive number of Hz"):
            make()
