"""Identification of an oscillator with Bouc–Wen hysteresis."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.stage.oscillators import RATE_HZ, an_oscillator, multisine
from torchpi.errors import ConfigError, RecordingError
from torchpi.identification.bouc_wen_oscillator import OscillatorOptions, identify_oscillator
from torchpi.operators.bouc_wen_oscillator import BoucWenParameters
from torchpi.recordings.force import read_force_recording
from torchpi.recordings.options import RecordingOptions
from torchpi.recordings.recording import Recording
from torchpi.stage.bouc_wen_oscillator import BoucWenOscillator

BENCHMARK = Path(__file__).parents[3] / "shared" / "data" / "bouc_wen" / "train.h5"
PUBLISHED = BoucWenParameters(2.0, 10.0, 5e4, 5e4, 1e3 * 0.8, 1e3 * -1.1, 1.0)
"""Noël and Schoukens, 2016, table 1: parameters that the fit must recover."""
NOISE_UM = 2.0


def recorded(oscillator: BoucWenOscillator, u: np.ndarray, seed: int = 0) -> Recording:
    """Return a recording that starts at rest, with noise and a sensor offset."""
    y = oscillator.simulate(torch.from_numpy(u)[None])[0].numpy()
    y += NOISE_UM * np.random.default_rng(seed).standard_normal(len(u)) + 7.0
    return Recording(f"seed {seed}", np.arange(len(u)) / RATE_HZ, u, y, RATE_HZ)


def error_of(found: BoucWenOscillator, true: BoucWenOscillator) -> float:
    """Return the relative error on a motion that was not fitted."""
    u = torch.from_numpy(multisine(2048, 12.0, seed=99))[None]
    y, expected = found.simulate(u), true.simulate(u)
    return float((y - y.mean() - expected + expected.mean()).std() / expected.std())


def test_physical_parameters_are_recovered_from_noisy_recordings() -> None:
    # The recordings are integrated at a higher rate and with other steps than the fit uses.
    true = an_oscillator()
    fine = [true.at_sample_rate(4 * RATE_HZ) for _ in range(2)]
    recordings = []
    for seed, one in enumerate(fine):
        u = multisine(1536, 12.0 - 4 * seed, seed, factor=4)
        whole = recorded(one, u, seed)
        recordings.append(replace(whole, t=whole.t[::4] / 4, u=u[::4], y=whole.y[::4]))
    found = identify_oscillator(recordings)
    assert found.oscillator.between == "band_limited"
    assert found.oscillator.get_buffer("offset_um").item() == pytest.approx(7.0, abs=0.3)
    assert error_of(found.oscillator, true) < 2e-3
    for name, value in true.values._asdict().items():
        width = found.half_widths[name] or 1e-9
        assert abs(found.oscillator.values._asdict()[name] - value) < 2 * width, name
        assert width < 0.15 * abs(value), name


def test_an_exponent_other_than_1_and_a_held_force_are_identified() -> None:
    unit = 10.0**0.8
    true = an_oscillator(between="held", exponent=1.8, dissipation=900.0 / unit, hardening=300.0 / unit)
    found = identify_oscillator([recorded(true, multisine(2048, 15.0))])
    assert found.oscillator.between == "held"
    assert found.oscillator.values.exponent == pytest.approx(
        1.8, abs=2 * (found.half_widths["exponent"] or 0.0)
    )
    assert error_of(found.oscillator, true) < 3e-3


def test_samples_that_do_not_count_do_not_affect_the_fit() -> None:
    one = recorded(an_oscillator(), multisine(1024, 12.0))
    counted = np.arange(len(one)) < 640
    spoilt = replace(one, y=np.where(counted, one.y, 1e4))
    options = OscillatorOptions(between="band_limited", exponent=1.0)
    first, second = (identify_oscillator([every], [counted], options) for every in (one, spoilt))
    assert first.oscillator.plain() == second.oscillator.plain()


@pytest.mark.skipif(not BENCHMARK.is_file(), reason="the recording of the Bouc–Wen benchmark is not here")
def test_on_the_benchmark_published_parameters_are_found_and_only_noise_remains() -> None:
    options = RecordingOptions(
        input_column="multisine/u", output_column="multisine/y", output_unit="m", fs_hz="multisine/fs"
    )
    whole = read_force_recording(BENCHMARK, options)
    length = 3072
    one = replace(whole, t=whole.t[:length], u=whole.u[:length], y=whole.y[:length])
    counted = np.arange(length) < 3 * length // 4
    found = identify_oscillator([one], [counted], OscillatorOptions("band_limited", 1.0)).oscillator
    for name, value in PUBLISHED._asdict().items():
        assert found.values._asdict()[name] == pytest.approx(value, rel=0.03), name
    error = one.y - found.simulate(torch.from_numpy(one.u)[None])[0].numpy()
    periods = whole.y.reshape(5, -1)[1:]
    noise = float((periods - periods.mean(0)).std() * np.sqrt(4 / 3))
    assert np.sqrt(np.mean(error[~counted] ** 2)) < 1.03 * noise
    reference = BoucWenOscillator(750.0, PUBLISHED._asdict()).simulate(torch.from_numpy(one.u)[None], True)
    assert float((found.simulate(torch.from_numpy(one.u)[None], True) - reference).std()) < 0.8  # µm


def test_unsuitable_recordings_are_refused_with_the_reason() -> None:
    random = np.random.default_rng(0)
    noise = Recording("noise", np.arange(2000) / RATE_HZ, *random.standard_normal((2, 2000)), RATE_HZ)
    one = recorded(an_oscillator(), multisine(1024))
    for recordings, message in (
        ([noise], "noise: found (no mode in the frequency response|a residual of .* rms of)"),
        ([one, replace(one, name="other", fs_hz=600.0)], "other: found 600 Hz, expected 500 Hz as in seed 0"),
        ([replace(one, t=one.t[:300], u=one.u[:300], y=one.y[:300])], "found 300 consecutive samples to fit"),
        ([replace(one, u=np.ones(1024))], "found a constant force or displacement"),
    ):
        with pytest.raises(RecordingError, match=message):
            identify_oscillator(recordings)


def test_an_invalid_option_is_refused_by_name() -> None:
    with pytest.raises(ConfigError, match="between: found 'cubic', expected one of"):
        OscillatorOptions(between="cubic")
    with pytest.raises(ConfigError, match=r"exponent: found 9, expected a number from 0\.5 to 6"):
        OscillatorOptions(exponent=9)
