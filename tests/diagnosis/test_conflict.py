"""Conflict: recordings that need different stages are reported; noise and a shared misfit are not."""

import dataclasses

import numpy as np
import pytest

from torchpi.diagnosis.conflict import conflict, gain_and_offset
from torchpi.diagnosis.diagnosis import Trace

FS_HZ, NOISE_UM, N = 10_000.0, 0.004, 20_000
U = 5 - 5 * np.cos(2 * np.pi * 7 * np.arange(N) / FS_HZ)


def recording(name: str, gain: float, offset_um: float = 0.0, seed: int = 0) -> Trace:
    """Record a stage of 0.8 µm/V with the recording's own gain and offset in the residual."""
    noise = NOISE_UM * np.random.default_rng(seed).standard_normal(N)
    e = gain * 0.8 * (U - U.mean()) + offset_um + noise
    return Trace(name, FS_HZ, np.arange(N) / FS_HZ, U, 0.8 * U + e, np.zeros(N, bool), e, e)


def test_recordings_of_one_stage_agree() -> None:
    for seed in range(30):
        traces = [recording(name, 0.0, seed=3 * seed + i) for i, name in enumerate("abc")]
        assert conflict(traces, NOISE_UM) == ()


def test_a_single_recording_has_no_conflict() -> None:
    assert conflict([recording("a", 0.05)], NOISE_UM) == ()


def test_a_different_gain_is_reported_with_its_size() -> None:
    traces = [recording("a", -0.005, seed=1), recording("b", -0.005, seed=2), recording("c", 0.01, seed=3)]
    (line,) = conflict(traces, NOISE_UM)
    assert line.startswith("Recording c needs a larger gain than the others (+1.5 ± ")
    assert "another stage, load or sensor setting" in line


def test_a_conflict_of_two_recordings_is_reported_in_one_sentence() -> None:
    (line,) = conflict([recording("a", -0.005, seed=1), recording("b", 0.005, seed=2)], NOISE_UM)
    assert "1" in line and "gain" in line


def test_a_different_offset_is_reported_in_nanometres() -> None:
    traces = [recording(name, 0.0, -0.01, i) for i, name in enumerate("ab")] + [recording("c", 0.0, 0.02, 9)]
    (line,) = conflict(traces, NOISE_UM)
    assert line.startswith("Recording c needs a different offset from the others (+30")


def test_a_conflict_that_the_named_effects_resolve_is_reported_as_accounted_for() -> None:
    quiet = recording("c", 0.0, seed=5).residual_retuned
    traces = [
        recording("a", 0.0, seed=1),
        recording("b", 0.0, seed=2),
        dataclasses.replace(recording("c", 0.02, seed=3), residual_augmented=quiet),
    ]
    (line,) = conflict(traces, NOISE_UM)
    assert line.endswith("the named effects account for this.")


def test_a_slow_residual_counts_as_few_independent_samples() -> None:
    """A drift of half a period over the recording must not count as an offset of many independent samples."""
    slow = 0.02 * np.cos(np.pi * np.arange(N) / N + np.random.default_rng(0).uniform(0, 6, (200, 1)))
    noise = NOISE_UM * np.random.default_rng(1).standard_normal(N)
    base = recording("a", 0.0)
    scores = []
    for one in slow[:50]:
        found = gain_and_offset(base, one + noise, NOISE_UM)
        scores.append(found.gain / found.gain_sd)
    assert np.abs(scores).max() < 4


def test_the_stated_uncertainty_of_a_gain_matches_its_scatter() -> None:
    traces = [recording("a", 0.003, seed=seed) for seed in range(60)]
    gains = [gain_and_offset(trace, trace.residual_retuned, 0.0) for trace in traces]
    z = np.array([(one.gain - 0.003 / 1.0) / one.gain_sd for one in gains])
    assert np.std([one.gain for one in gains]) == pytest.approx(
        np.mean([one.gain_sd for one in gains]), rel=0.3
    )
    assert np.abs(z).max() < 6
