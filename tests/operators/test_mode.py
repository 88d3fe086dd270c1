"""A mode rings at its frequency, dies at its damping, and is what control says it is."""

import math

import control
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchpi.errors import StageError
from torchpi.operators.conformance import OperatorLaws, wandering
from torchpi.operators.mode import Mode


class TestLaws(OperatorLaws):
    def operator(self) -> Mode:
        return Mode(sample_period_s=0.1, frequency_hz=0.7, damping_ratio=0.15)


def ring_down(frequency_hz: float, damping_ratio: float, fs_hz: float) -> np.ndarray:
    """The response to a step, less the step; time starts with it."""
    y, _ = Mode(1 / fs_hz, frequency_hz, damping_ratio)(
        torch.ones(1, round(0.2 * fs_hz), dtype=torch.float64)
    )
    return y[0].detach().numpy() - 1.0


@given(frequency_hz=st.floats(400, 800), damping_ratio=st.floats(0.005, 0.05))
def test_a_step_rings_at_the_damped_frequency_and_decays_by_the_damping(frequency_hz, damping_ratio):
    fs_hz = 100_000.0
    e = ring_down(frequency_hz, damping_ratio, fs_hz)
    upward = np.flatnonzero((e[:-1] < 0) & (e[1:] >= 0))[:20]
    crossings = upward + e[upward] / (e[upward] - e[upward + 1])
    damped_hz = frequency_hz * math.sqrt(1 - damping_ratio**2)
    assert fs_hz / np.diff(crossings).mean() == pytest.approx(damped_hz, rel=1e-4)
    turns = 10
    period = fs_hz / damped_hz
    peaks = [e[round(k * period) : round((k + 1) * period)].max() for k in (1, 1 + turns)]
    decrement = math.log(peaks[0] / peaks[1]) / turns
    assert decrement / math.sqrt(4 * math.pi**2 + decrement**2) == pytest.approx(damping_ratio, rel=0.02)


def test_response_is_that_of_control():
    frequency_hz, damping_ratio, period_s = 620.0, 0.02, 1e-4
    u = wandering(1, 500)
    omega = 2 * math.pi * frequency_hz
    system = control.tf([omega**2], [1, 2 * damping_ratio * omega, omega**2])
    wanted = control.forced_response(system, period_s * np.arange(500), u[0].numpy()).outputs
    y, _ = Mode(period_s, frequency_hz, damping_ratio)(u)
    np.testing.assert_allclose(y[0].detach().numpy(), wanted, rtol=0, atol=1e-9)


def test_static_gain_is_one_and_an_undamped_mode_is_allowed():
    u = torch.ones(1, 20_000, dtype=torch.float64)
    assert Mode(1e-4, 620.0, 0.02)(u)[0][0, -1].item() == pytest.approx(1.0, abs=1e-12)
    undamped = Mode(1e-4, 620.0, 0.0)(u)[0]
    assert undamped[0, -1000:].max().item() == pytest.approx(2.0, abs=0.02)


@pytest.mark.parametrize(
    ("frequency_hz", "damping_ratio", "message"),
    [
        (0.0, 0.02, "frequency_hz: found 0 Hz, want a positive number of Hz"),
        (620.0, -0.1, "damping_ratio: found -0.1, want at least 0"),
        (620.0, math.nan, "damping_ratio: found nan, want at least 0"),
    ],
)
def test_an_unphysical_mode_is_refused(frequency_hz, damping_ratio, message):
    with pytest.raises(StageError, match=message):
        Mode(1e-4, frequency_hz, damping_ratio)
