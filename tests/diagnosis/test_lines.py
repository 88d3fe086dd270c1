"""A spectral line stands out from its surroundings; a ringing mode does not."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from tests.diagnosis.prepared import prepared
from torchpi.diagnosis.hypothesis import EffectTerm
from torchpi.diagnosis.lines import RESOLVED, STANDS_OUT, above_surroundings, is_overtone
from torchpi.diagnosis.posterior import Believed, with_overtones
from torchpi.recordings.recording import Recording
from torchpi.stage.effects.sensor.gain_modulation import GainModulation
from torchpi.stage.effects.sensor.hum import Hum

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


@given(st.floats(45.0, 65.0), st.integers(2, 20), st.floats(200.0, 5000.0))
def test_what_sampling_makes_of_a_harmonic_is_an_overtone(mains_hz: float, order: int, fs_hz: float) -> None:
    k = np.arange(2000)
    seen = np.abs(np.fft.rfft(np.cos(2 * np.pi * order * mains_hz * k / fs_hz) * np.hanning(2000)))
    sampled_hz = float(seen.argmax()) * fs_hz / 2000
    length_s = 0.5 * RESOLVED * 2000 / fs_hz  # the spectrum resolves a frequency to half a bin
    assert is_overtone(sampled_hz, mains_hz, fs_hz, length_s)


@pytest.mark.parametrize(("line_hz", "merged"), [(20.0, True), (17.0, False), (60.0, False)])
def test_an_aliased_harmonic_of_the_mains_is_no_second_cause(line_hz: float, merged: bool) -> None:
    """At 500 Hz the eighth harmonic of 60 Hz, 480 Hz, appears at 20 Hz."""
    t = np.arange(2000) / 500.0
    records = prepared([Recording("a", t, np.sin(t), np.sin(t), 500.0)])
    amplitudes = ({"cos_um": 1.0, "sin_um": 0.0},)
    terms = {
        "hum": EffectTerm(Hum, {"frequency_hz": 60.0}, amplitudes),
        "gain_modulation": EffectTerm(GainModulation, {"frequency_hz": line_hz}, amplitudes),
    }
    found = [Believed(name, 0.9, (), size, (), 0.9) for name, size in zip(terms, (1.0, 0.2), strict=True)]
    one = with_overtones(found, terms, records)
    assert [each.name for each in one] == ["hum"] if merged else ["hum", "gain_modulation"]
    assert sum(each.explained_um2 for each in one) == pytest.approx(1.2)
