"""Resonance: a mode in series, compared with its closed form; peaks of a residual."""

import math

import control
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws, step
from torchpi.errors import StageError
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.effect import DataRange
from torchpi.stage.effects.mechanics.modal import ModalResonance, ModalSecondMode
from torchpi.stage.effects.mechanics.resonance import Resonance, peaks_hz

SEEN = DataRange(2e4, 1.0, 0, 1, 1, 0, 1, {})


class TestLaws(EffectLaws):
    def operator(self) -> Resonance:
        return Resonance(PERIOD_S, frequency_hz=1.3, damping_ratio=0.05)


class TestLawsInThePlaceOfAnother(EffectLaws):
    def operator(self) -> Resonance:
        return Resonance(
            PERIOD_S,
            frequency_hz=1.3,
            damping_ratio=0.05,
            replaced_frequency_hz=1.1,
            replaced_damping_ratio=0.03,
        )


@given(frequency_hz=st.floats(100.0, 800.0), replaced_hz=st.floats(100.0, 800.0))
def test_in_series_with_the_mode_that_it_replaces_only_the_new_mode_remains(frequency_hz, replaced_hz):
    x = wandering(1, 4000)
    own, replaced = (
        {"frequency_hz": frequency_hz, "damping_ratio": 0.02},
        {"frequency_hz": replaced_hz, "damping_ratio": 0.05},
    )
    other = {f"replaced_{name}": value for name, value in replaced.items()}
    # At a hundredth of the shortest period, the course of the input between samples does not matter.
    y = Resonance(1e-5, **own, **other)(Resonance(1e-5, **replaced)(x)[0])[0]
    torch.testing.assert_close(y, Resonance(1e-5, **own)(x)[0], rtol=0, atol=2e-3)


@given(frequency_hz=st.floats(5.0, 2e3), damping_ratio=st.floats(0.001, 0.29))
def test_the_response_to_a_ramp_matches_the_closed_form(frequency_hz, damping_ratio):
    t = torch.arange(500, dtype=torch.float64) / 1e4
    y = Resonance(1e-4, frequency_hz=frequency_hz, damping_ratio=damping_ratio)(t[None])[0][0]
    omega = 2 * math.pi * frequency_hz
    damped = omega * math.sqrt(1 - damping_ratio**2)
    # y = t - 2ζ/ω₀ + e^{-ζω₀t} (2ζ/ω₀ cos ω_d t + (2ζ² - 1)/ω_d sin ω_d t)
    ringing = 2 * damping_ratio / omega * torch.cos(damped * t)
    ringing = ringing + (2 * damping_ratio**2 - 1) / damped * torch.sin(damped * t)
    wanted = t - 2 * damping_ratio / omega + torch.exp(-damping_ratio * omega * t) * ringing
    torch.testing.assert_close(y.detach(), wanted, rtol=0, atol=1e-12)


@given(frequency_hz=st.floats(400, 800), damping_ratio=st.floats(0.005, 0.05))
def test_a_step_rings_at_the_damped_frequency_and_decays_with_the_damping(frequency_hz, damping_ratio):
    fs_hz = 100_000.0
    y = Resonance(1 / fs_hz, frequency_hz=frequency_hz, damping_ratio=damping_ratio)(step(20_000))[0][0]
    e = y.detach().numpy() - 1.0
    upward = np.flatnonzero((e[:-1] < 0) & (e[1:] >= 0))[:20]
    crossings = upward + e[upward] / (e[upward] - e[upward + 1])
    damped_hz = frequency_hz * math.sqrt(1 - damping_ratio**2)
    assert fs_hz / np.diff(crossings).mean() == pytest.approx(damped_hz, rel=1e-4)
    turns = 10
    period = fs_hz / damped_hz
    peaks = [e[round(k * period) : round((k + 1) * period)].max() for k in (1, 1 + turns)]
    decrement = math.log(peaks[0] / peaks[1]) / turns
    assert decrement / math.sqrt(4 * math.pi**2 + decrement**2) == pytest.approx(damping_ratio, rel=0.02)


def test_the_response_matches_python_control():
    frequency_hz, damping_ratio, period_s = 620.0, 0.02, 1e-4
    u = wandering(1, 500)
    omega = 2 * math.pi * frequency_hz
    system = control.tf([omega**2], [1, 2 * damping_ratio * omega, omega**2])
    wanted = control.forced_response(system, period_s * np.arange(500), u[0].numpy()).outputs
    y, _ = Resonance(period_s, frequency_hz=frequency_hz, damping_ratio=damping_ratio)(u)
    np.testing.assert_allclose(y[0].detach().numpy(), wanted, rtol=0, atol=1e-9)


def test_a_mode_may_be_undamped_or_hardly_ring():
    undamped = Resonance(1e-4, frequency_hz=620.0, damping_ratio=0.0)(step(20_000))[0]
    assert undamped[0, -1000:].max().item() == pytest.approx(2.0, abs=0.02)
    stiff = Resonance(1e-4, frequency_hz=620.0, damping_ratio=0.7)(step(20_000))[0]
    assert stiff.max().item() == pytest.approx(1.046, abs=1e-3)


@pytest.mark.parametrize(
    ("frequency_hz", "damping_ratio", "message"),
    [
        (0.0, 0.02, "frequency_hz: found 0 Hz, expected a positive number of Hz"),
        (620.0, -0.1, "damping_ratio: found -0.1, expected at least 0"),
        (620.0, math.nan, "damping_ratio: found nan, expected at least 0"),
    ],
)
def test_an_unphysical_mode_is_refused(frequency_hz, damping_ratio, message):
    with pytest.raises(StageError, match=message):
        Resonance(1e-4, frequency_hz=frequency_hz, damping_ratio=damping_ratio)


@pytest.mark.parametrize("frequency_hz", [480.0, 500.0, 1e3, 1e5])
def test_a_mode_near_or_above_half_the_sample_rate_stays_bounded(frequency_hz):
    x = wandering(1, 2000)
    effect = Resonance(1e-3, frequency_hz=frequency_hz, damping_ratio=0.01)
    y = effect(x)[0]
    assert bool((y.abs() <= 3 * x.abs().max()).all())
    y.square().sum().backward()
    assert bool(effect.frequency_hz.grad.isfinite()) and bool(effect.damping_ratio.grad.isfinite())


@given(seed=st.integers(0, 10**6), frequency_hz=st.floats(120.0, 3e3))
def test_the_first_peak_of_a_noisy_residual_is_at_the_mode(seed, frequency_hz):
    generator = torch.Generator().manual_seed(seed)
    x = 0.01 * torch.randn(1, 40_000, dtype=torch.float64, generator=generator).cumsum(1)
    residual = Resonance(1e-4, frequency_hz=frequency_hz, damping_ratio=0.01)(x)[0][0] - x[0]
    noise = 0.003 * torch.randn(40_000, dtype=torch.float64, generator=generator)
    assert peaks_hz(residual + noise, 1e4)[0] == pytest.approx(frequency_hz, rel=0.02)


def test_a_search_starts_at_given_peaks_or_on_a_grid():
    grid = [start["frequency_hz"] for start in Resonance.starts(SEEN)]
    assert grid[0] == pytest.approx(100.0) and grid[-1] == pytest.approx(5e3)
    assert [start["frequency_hz"] for start in Resonance.starts_at(SEEN, [321.0, 1e5])] == [321.0]


@pytest.mark.parametrize("effect", [Resonance, ModalResonance, ModalSecondMode])
def test_a_mode_close_to_half_of_the_sample_rate_is_out_of_reach(effect):
    assert effect.reached({"frequency_hz": 0.4 * SEEN.fs_hz}, SEEN)
    assert not effect.reached({"frequency_hz": 0.47 * SEEN.fs_hz}, SEEN)
    assert all(effect.reached(start, SEEN) for start in Resonance.starts(SEEN))
