"""Errors of a stage that remain after a linear correction at one amplitude."""

from collections.abc import Callable

import numpy as np
import pytest

from benchmarks.mirror_folds import level_of, missed_between, not_linear
from torchpi.recordings.multi_axis import MultiAxisRecording

SAMPLES, REALISATIONS, INPUTS, OUTPUTS = 512, 6, 3, 2


def level() -> list[MultiAxisRecording]:
    random = np.random.default_rng(0)
    return [
        MultiAxisRecording(
            f"100mV_train {k}",
            np.tile(random.normal(size=(SAMPLES, INPUTS)), (2, 1)),
            np.zeros((2 * SAMPLES, OUTPUTS)),
            1e3,
            2,
        )
        for k in range(REALISATIONS)
    ]


def errors(of: Callable[[np.ndarray], np.ndarray], noise: float) -> list[np.ndarray]:
    random = np.random.default_rng(1)
    return [of(one.period[0]) + noise * random.normal(size=(SAMPLES, OUTPUTS)) for one in level()]


def delayed(u: np.ndarray) -> np.ndarray:
    return np.roll(u, 3, axis=0) @ np.array([[1.0, 0.5], [0.2, -1.0], [0.7, 0.1]])


def test_a_linear_error_is_removed_and_noise_keeps_its_rms() -> None:
    assert not_linear(level(), errors(delayed, 0.0)) < 1e-9
    assert not_linear(level(), errors(delayed, 0.1)) == pytest.approx(0.1, rel=0.03)


def test_a_nonlinear_error_is_kept() -> None:
    even = [e - e.mean(0) for e in errors(lambda u: delayed(u) ** 2, 0.0)]
    assert not_linear(level(), even) == pytest.approx(np.sqrt(np.mean(np.square(even))), rel=0.05)


def test_the_level_is_read_from_the_name() -> None:
    assert level_of(level()[0]) == "100mV"


def test_only_a_mode_that_moved_is_missed_between_neighbouring_levels() -> None:
    """Each level has one mode, whose stiffness varies with the square root of the amplitude."""
    random, lines = np.random.default_rng(2), np.arange(SAMPLES // 2 + 1)

    def recordings(rms: float, moved: float) -> list[MultiAxisRecording]:
        stiffness = 100.0**2 * (1 - 0.1 * np.sqrt(rms) + moved)
        mode = 100.0**2 / (stiffness - lines**2 + 2j * lines)
        found = []
        for k in range(REALISATIONS):
            u = random.normal(size=(SAMPLES, 2))
            u *= rms / u.std()
            y = np.fft.irfft(
                mode[:, None] * np.fft.rfft(u, axis=0) @ np.array([[1.0, 0.3], [0.2, -1.0]]), axis=0
            )
            found.append(MultiAxisRecording(f"{rms} {k}", np.tile(u, (2, 1)), np.tile(y, (2, 1)), 1e3, 2))
        return found

    lower, upper = recordings(0.1, 0.0), recordings(0.3, 0.0)
    for moved, least, most in ((0.0, 0.0, 1e-3), (0.02, 0.1, 1.0)):
        level = recordings(0.2, moved)
        _, missed = missed_between(lower, level, upper)
        assert least <= np.sqrt(missed.sum()) / np.std([one.y for one in level]) <= most
