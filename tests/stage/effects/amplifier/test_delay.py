"""Delay: its length, whole samples and fractions, alone and behind the lag of a held command."""

import math

import numpy as np
import pytest
import scipy.signal
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws
from torchpi.errors import StageError
from torchpi.operators.chain import Chain
from torchpi.operators.conformance import wandering
from torchpi.stage.alignment import OneSampleLate
from torchpi.stage.effects.amplifier.amplifier_lag import AmplifierLag
from torchpi.stage.effects.amplifier.delay import Delay
from torchpi.stage.effects.effect import DataRange
from torchpi.stage.effects.held import hold_first_block


class TestLaws(EffectLaws):
    def operator(self) -> Delay:
        return Delay(PERIOD_S, delay_s=0.0037)


class TestLawsOfALongDelay(EffectLaws):
    def operator(self) -> Delay:
        return Delay(PERIOD_S, delay_s=0.237)


@given(delay_s=st.floats(0.0, 0.01), fs_hz=st.sampled_from([1e3, 3e4]))
def test_a_ramp_is_late_by_exactly_the_delay(delay_s, fs_hz):
    t = torch.arange(400, dtype=torch.float64)[None] / fs_hz
    y = Delay(1 / fs_hz, delay_s=delay_s)(t)[0]
    torch.testing.assert_close(y.detach(), (t - delay_s).clamp(min=0), rtol=0, atol=1e-12)


def test_the_state_has_the_same_shape_for_every_delay():
    x = wandering(1, 200)
    states = [Delay(1e-4, delay_s=delay_s)(x)[1] for delay_s in (0.0, 1e-3, 0.01)]
    assert {state.shape for state in states} == {(1, 102)}


def test_a_delay_of_zero_has_a_gradient():
    effect, x = Delay(0.001), wandering(1, 50)
    effect(x)[0][0, 20].backward()
    assert effect.delay_s.grad.item() == pytest.approx(-(x[0, 20] - x[0, 19]).item() / 0.001)


@pytest.mark.parametrize(("fs_hz", "longest_s"), [(200.0, 0.05), (1e4, 2e-3), (5e4, 4e-4)])
def test_a_search_starts_at_delays_of_half_a_sample_to_at_most_twenty_samples(
    fs_hz: float, longest_s: float
) -> None:
    delays = [start["delay_s"] for start in Delay.starts(DataRange(fs_hz, 10.0, 0, 1, 1, 0, 1, {}))]
    assert delays[0] == 0.5 / fs_hz and delays[-1] == pytest.approx(longest_s)


@given(samples=st.integers(0, 25))
def test_a_delay_of_whole_samples_is_a_shift(samples):
    x = wandering(2, 60)
    y, _ = Delay(0.5, delay_s=0.5 * samples)(x)
    assert torch.equal(y[:, samples:], x[:, : 60 - samples]) and bool((y[:, :samples] == 0).all())


def test_windows_may_be_shorter_than_the_delay():
    delay, x = Delay(0.1, delay_s=1.23), wandering(1, 60)
    state, ys = None, []
    for t in range(60):
        y, state = delay(x[:, t : t + 1], state)
        ys.append(y)
    assert torch.equal(torch.cat(ys, 1), delay(x)[0])


def test_a_delay_that_training_has_made_negative_is_refused():
    delay = Delay(0.1, delay_s=0.1)
    with torch.no_grad():
        delay.delay_s -= 0.2
    with pytest.raises(StageError, match=r"delay_s: found -0.1 s"):
        delay(wandering(1, 5))


def held(period_s: float, cutoff_hz: float | None, delay_s: float) -> Chain:
    """Return the chain of hold, lag and delay in which y(k) depends on commands up to tick k - 1."""
    lag = None if cutoff_hz is None else AmplifierLag(period_s, cutoff_hz=cutoff_hz)
    delay = Delay(period_s, delay_s=delay_s, after_lag=1.0)
    hold_first_block([delay] if lag is None else [lag, delay], False)
    return Chain(late=OneSampleLate(), lag=lag, delay=delay)


@given(parts=st.integers(0, 350), cutoff_hz=st.floats(0.2, 20.0))
def test_behind_the_lag_of_a_held_command_a_fractional_delay_is_exact(parts, cutoff_hz):
    period_s, fine = 0.1, 100  # delays are multiples of a hundredth of a sample, up to 3.5 samples
    u = wandering(1, 30)
    command = np.r_[np.zeros(parts), np.repeat(u[0].numpy(), fine)]
    times = period_s / fine * np.arange(len(command))
    omega = 2 * math.pi * cutoff_hz
    _, wanted, _ = scipy.signal.lsim(([[-omega]], [[omega]], [[1.0]], [[0.0]]), command, times, interp=False)
    v, _ = held(period_s, cutoff_hz, parts / fine * period_s)(u)
    np.testing.assert_allclose(v[0].detach().numpy(), wanted[: 30 * fine : fine], rtol=0, atol=1e-10)


def test_a_held_lagged_and_delayed_command_does_not_depend_on_the_sample_rate():
    u = wandering(1, 50)
    slow, _ = held(1e-4, 2000.0, 1.3e-4)(u)
    fast, _ = held(1e-5, 2000.0, 1.3e-4)(u.repeat_interleave(10, 1))
    torch.testing.assert_close(fast[:, ::10], slow, rtol=0, atol=1e-12)


def test_unless_it_follows_a_lag_of_one_pole_a_delay_interpolates_linearly():
    x, delay, straight = wandering(2, 60), Delay(0.1, delay_s=0.237, after_lag=1.0), Delay(0.1, delay_s=0.237)
    assert torch.equal(delay(x)[0], straight(x)[0])
    hold_first_block([AmplifierLag(0.1, cutoff_hz=2.0), delay], False)
    assert not torch.equal(delay(x)[0], straight(x)[0])
    hold_first_block([AmplifierLag(0.1, cutoff_hz=2.0, damping_ratio=0.7), delay], False)
    assert torch.equal(delay(x)[0], straight(x)[0])


def test_a_fit_moves_the_delay_across_whole_samples():
    u = wandering(1, 400)
    wanted = held(1e-4, 1500.0, 3.4e-4)(u)[0].detach()
    chain = held(1e-4, 1500.0, 0.7e-4)
    for _ in range(60):  # Gauss–Newton in the one unknown
        error, delay_s = chain(u)[0] - wanted, chain.delay.delay_s
        (slope,) = torch.autograd.grad((error.detach() * error).sum(), delay_s)
        probe = held(1e-4, 1500.0, delay_s.item() + 1e-9)(u)[0].detach()
        curvature = (((probe - wanted - error.detach()) / 1e-9) ** 2).sum()
        with torch.no_grad():
            delay_s -= slope / curvature
    assert delay_s.item() == pytest.approx(3.4e-4, rel=1e-6)


def test_gradients_of_a_delay_behind_a_lag_match_finite_differences():
    chain, u = held(0.1, 1.3, 0.237), wandering(2, 12)
    names = ["lag.cutoff_hz", "delay.delay_s"]
    parameters = [chain.get_parameter(name) for name in names]

    def output(*values: torch.Tensor) -> torch.Tensor:
        return torch.func.functional_call(chain, dict(zip(names, values, strict=True)), (u,))[0]

    inputs = [parameter.detach().clone().requires_grad_() for parameter in parameters]
    assert torch.autograd.gradcheck(output, inputs, eps=1e-7, atol=1e-5)
