"""A spectral line stands out from its surroundings; a ringing mode does not."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from torchpi.diagnosis.lines import STANDS_OUT, above_surroundings

SAMPLES = 5000


@given(st.floats(20, 2000), st.floats(0, 6.28), st.integers(0, 999))
@settings(max_examples=50, deadline=None)
def test_a_line_of_half_the_noise_stands_out_and_noise_does_not(
    cycles: float, phase: float, seed: int
) -> None:
    noise = np.random.default_rng(seed).standard_normal(SAMPLES)
    line = 0.7 * np.sin(2 * np.pi * cycles * np.arange(SAMPLES) / SAMPLES + phase)
    assert above_surroundings(noise + line, cycles) > STANDS_OUT > above_surroundings(noise, cycles)


@pytest.mark.parametrize("seed", range(20))
def test_a_mode_driven_by_noise_is_not_a_line(seed: int) -> None:
    radius, cycles = 0.995, 500.0
    poles = [1, -2 * radius * np.cos(2 * np.pi * cycles / SAMPLES), radius**2]
    ringing = lfilter([1.0], poles, np.random.default_rng(seed).standard_normal(SAMPLES))
    assert above_surroundings(ringing, cycles) < STANDS_OUT


@pytest.mark.parametrize("cycles", [0.0, 8.0, 2495.0, 1e6])
def test_nothing_stands_out_at_a_frequency_without_surroundings(cycles: float) -> None:
    assert above_surroundings(np.random.default_rng(1).standard_normal(SAMPLES), cycles) == 0.0
