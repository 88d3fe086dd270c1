"""Detection lines: planted parts are classified correctly, aperiodic ones are not called periodic."""

import numpy as np
import pytest

from torchpi.diagnosis.diagnosis import Trace
from torchpi.diagnosis.locate import SIGNIFICANT
from torchpi.diagnosis.multisine import Parts, all_parts, multisine, sentence
from torchpi.diagnosis.repeats import Stretch, periodic_stretches
from torchpi.excitation.signals import multisine as random_phase

FS_HZ, NOISE_UM = 5_000.0, 0.004
_, U = random_phase(8.0, FS_HZ, 0, 10, 1, 200, 2, odd_lines=True, detection_lines=True, seed=2)
X = (U - 5) / 5


def trace(e: np.ndarray, u: np.ndarray = U) -> Trace:
    t = np.arange(len(u)) / FS_HZ
    return Trace("multisine", FS_HZ, t, u, 0.8 * u + e, np.zeros(len(u), bool), e, e)


def parts(e: np.ndarray, seed: int = 0) -> Parts:
    noisy = e + NOISE_UM * np.random.default_rng(seed).standard_normal(len(U))
    (found,) = multisine(trace(noisy), noisy)
    return found


def significant(found: Parts) -> set[str]:
    return {part for part, score in found.significance.items() if score > SIGNIFICANT}


def test_noise_has_no_significant_parts() -> None:
    scores = np.array([list(parts(0 * X, seed).significance.values()) for seed in range(60)])
    assert scores.max() < SIGNIFICANT
    found = parts(0 * X)
    assert found.noise_um == pytest.approx(NOISE_UM, rel=0.03)
    assert "nothing above the noise" in sentence(found)


def test_a_lag_is_classified_as_linear() -> None:
    lag = -1e-5 * np.diff(U, prepend=U[0]) * FS_HZ
    found = parts(lag)
    assert significant(found) == {"linear"}
    assert found.rms_um["linear"] == pytest.approx(lag[-40_000:].std(), rel=0.05)


def test_a_square_appears_on_even_lines_only() -> None:
    found = parts(0.02 * X**2)
    assert significant(found) == {"even"}
    assert found.rms_um["even"] == pytest.approx(0.02 * (X[-40_000:] ** 2).std(), rel=0.1)
    assert "even" in sentence(found)


def test_a_cube_appears_on_excited_and_unexcited_odd_lines() -> None:
    assert significant(parts(0.05 * X**3)) == {"linear", "odd"}


@pytest.mark.parametrize(
    "e",
    [
        0.01 * np.arange(len(U)) / len(U),
        0.005 * np.sin(2 * np.pi * 50.03 * np.arange(len(U)) / FS_HZ),
        0.005 * np.sin(2 * np.pi * 150.0 * np.arange(len(U)) / FS_HZ),
        0.02 * np.exp(-np.arange(len(U)) / FS_HZ / 3),
    ],
    ids=["drift", "hum", "third harmonic of the mains, in step with the period", "decay"],
)
def test_drift_hum_and_decay_are_classified_as_non_periodic(e: np.ndarray) -> None:
    assert significant(parts(e)) == {"non_periodic"}


def test_without_detection_lines_distortion_is_reported_as_invisible() -> None:
    _, u = random_phase(4.0, FS_HZ, 0, 10, 1, 2_499.5, 4, mains_hz=(), seed=1)
    e = NOISE_UM * np.random.default_rng(0).standard_normal(len(u))
    (found,) = multisine(trace(e, u), e)
    assert found.periods == 4 and found.rms_um["odd"] is None and found.rms_um["even"] is None
    assert "no even and no odd line was left unexcited" in sentence(found)


def test_two_multisines_in_one_recording_are_two_stretches() -> None:
    period = U[-20_000:]
    u = np.concatenate(
        [np.zeros(3_000), period, period, np.linspace(period[-1], 0, 4_000), 0.3 * U[-40_000:]]
    )
    found = periodic_stretches(u)
    assert sorted(found, key=lambda one: one.start) == [Stretch(3_000, 20_000, 2), Stretch(47_000, 20_000, 2)]
    assert len(all_parts([trace(0 * u + 1e-3 * np.random.default_rng(0).standard_normal(len(u)), u)])) == 2
