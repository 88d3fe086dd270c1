"""Evidence is worth what independent numbers say, not samples."""

import numpy as np

from torchpi.diagnosis.evidence import bands, evidence

SAMPLES = 4000


def flicker(rng: np.random.Generator, samples: int = SAMPLES) -> np.ndarray:
    """Noise of power 1/f."""
    f = np.fft.rfftfreq(samples)
    f[0] = f[1]
    return np.fft.irfft(np.fft.rfft(rng.standard_normal(samples)) / np.sqrt(f), samples)


def test_exchanged_noise_is_worth_nothing() -> None:
    rng = np.random.default_rng(0)
    found = [evidence([rng.standard_normal(SAMPLES)], [rng.standard_normal(SAMPLES)]) for _ in range(40)]
    assert abs(np.mean(found)) < 15
    assert np.std(found) < 60  # √(2 · independent frequencies), as it must be for two draws


def test_the_same_noise_and_another_sign_is_worth_exactly_nothing() -> None:
    e = np.random.default_rng(0).standard_normal(SAMPLES)
    assert evidence([e], [-e]) == 0.0


def test_evidence_has_no_unit() -> None:
    rng = np.random.default_rng(1)
    one, other = rng.standard_normal((2, SAMPLES))
    assert np.isclose(evidence([one], [other]), evidence([1e-3 * one], [1e-3 * other]), rtol=1e-9)


def test_a_slow_drift_taken_out_of_flicker_noise_is_worth_its_few_frequencies() -> None:
    """A parabola fitted to flicker noise takes a tenth of its power away, and is hardly worth a parameter."""
    rng = np.random.default_rng(2)
    x, gained, power = np.linspace(-1, 1, SAMPLES), [], []
    for _ in range(40):
        e = flicker(rng)
        e -= e.mean()
        left = e - np.polynomial.polynomial.polyval(x, np.polynomial.polynomial.polyfit(x, e, 2))
        gained.append(evidence([e], [left]))
        power.append(1 - np.mean(left**2) / np.mean(e**2))
    # To a likelihood of white noise it would be worth a hundred and more.
    assert -0.5 * SAMPLES * np.log(1 - np.mean(power)) > 100
    assert np.mean(gained) < 3 and np.max(gained) < 8


def test_a_tone_in_white_noise_is_worth_much() -> None:
    t, noise = np.arange(SAMPLES) / 2000, np.random.default_rng(3).standard_normal(SAMPLES)
    tone = np.sqrt(2) * np.sin(2 * np.pi * 20 * t)
    assert evidence([noise + tone], [noise]) > 30


def test_evidence_of_several_recordings_adds_up() -> None:
    rng = np.random.default_rng(4)
    before = [rng.standard_normal(SAMPLES), rng.standard_normal(2000)]
    after = [0.8 * before[0], 0.7 * before[1]]
    both = evidence(before, after)
    assert np.isclose(both, evidence(before[:1], after[:1]) + evidence(before[1:], after[1:]))


def test_bands_hold_every_frequency_once() -> None:
    for samples in (100, 101, 999, 4000, 65_536):
        edges = bands(samples)
        assert edges[0] == 0 and edges[-1] == samples // 2 + 1 and (np.diff(edges) > 0).all()
