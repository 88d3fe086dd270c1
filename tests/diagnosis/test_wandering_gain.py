"""What counts as a gain that wanders, and what does not."""

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.diagnosis.plants import pair
from torchpi.diagnosis.decide import Decision
from torchpi.diagnosis.diagnose import diagnose
from torchpi.diagnosis.diagnosis import NamedEffect
from torchpi.diagnosis.wandering_gain import CELLS, wandering_gain, with_wandering_gain

TIME, NOISE_UM = 2000, 0.01
GAIN = 0.01
"""Rms of a walk of the gain."""

Residual = Callable[[np.ndarray, np.random.Generator], np.ndarray]


def motions() -> list[np.ndarray]:
    """(time,), µm: a chirp, and steps of random size."""
    t = np.arange(TIME) / TIME
    steps = np.random.default_rng(1).uniform(0, 10, 40).repeat(TIME // 40)
    return [5 - 5 * np.cos(2 * np.pi * (2 * t + 20 * t**2)), lfilter([0.3], [1, -0.7], steps)]


def walk(rng: np.random.Generator) -> np.ndarray:
    """(time,): a random walk that tends back to 0 within 100 samples, of rms 1, without its mean."""
    found = lfilter([1], [1, -0.99], rng.normal(size=TIME))
    return (found - found.mean()) / found.std()


def left(of: Residual) -> tuple[list[SimpleNamespace], SimpleNamespace]:
    """Return recordings, and a fit that leaves this function of their motion and noise."""
    rng = np.random.default_rng(2)
    residuals = [of(x, rng) + rng.normal(0, NOISE_UM, TIME) for x in motions()]
    counts = np.ones(TIME, dtype=bool)
    records = [
        SimpleNamespace(y=x + e, train=counts, held_out=~counts, period_s=1e-3)
        for x, e in zip(motions(), residuals, strict=True)
    ]
    return records, SimpleNamespace(residuals=residuals)


def of_a_gain(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return GAIN * walk(rng) * x


def of_a_gain_that_never_returns(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """It is so slow that the motion seems to predict a part of it, as of any slow signal."""
    found = np.cumsum(rng.normal(size=TIME))
    return GAIN * (found - found.mean()) / found.std() * x


def of_a_line_that_sweeps(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    t = np.arange(TIME) / TIME
    return GAIN * np.sqrt(2) * np.sin(2 * np.pi * (2 * t + 4 * t**2) + rng.uniform(0, 6)) * x


def of_an_added_walk(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return 0.05 * walk(rng)


def of_a_gain_that_ages(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return GAIN * np.linspace(-1, 1, TIME) * x


def of_a_gain_that_follows_the_motion(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return GAIN * (x - x.mean()) * x


def of_a_mode(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return lfilter([0.05], [1, -1.8, 0.95], np.gradient(np.gradient(x)))


def of_a_lag(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return lfilter([0.5], [1, -0.5], x) - x


def of_a_lag_that_depends_on_the_position(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return of_a_lag(x, rng) * x / 10


def of_a_burst(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A gain that moves for an eighth of the time."""
    return 10 * GAIN * walk(rng) * x * (np.abs(np.arange(TIME) / TIME - 0.4) < 1 / 16)


def of_a_gain_within_the_noise(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return 0.15 * of_a_gain(x, rng)


def of_noise(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.zeros(TIME)


@pytest.mark.parametrize("of", [of_a_gain, of_a_gain_that_never_returns, of_a_line_that_sweeps])
def test_a_gain_of_any_course_is_found_with_its_size_and_what_it_adds(of: Residual) -> None:
    records, fit = left(of)
    effect, adds = wandering_gain(records, fit, NOISE_UM)
    assert effect.probability > 0.9
    assert effect.share > 0.8
    assert effect.parameters[0].value == pytest.approx(GAIN, rel=0.3)
    known = slice(TIME // CELLS, None)  # the first stretch only determines the constants
    for added, e in zip(adds, fit.residuals, strict=True):
        assert np.corrcoef(added[known], e[known])[0, 1] > 0.9


@pytest.mark.parametrize(
    "of",
    [
        of_an_added_walk,
        of_a_gain_that_ages,
        of_a_gain_that_follows_the_motion,
        of_a_mode,
        of_a_lag,
        of_a_lag_that_depends_on_the_position,
        of_a_burst,
        of_a_gain_within_the_noise,
        of_noise,
    ],
)
@pytest.mark.parametrize("noise_um", [NOISE_UM, 0.0])
def test_no_other_residual_is_one(of: Residual, noise_um: float) -> None:
    assert wandering_gain(*left(of), noise_um)[0].probability < 0.1


def test_the_sealed_samples_decide_nothing() -> None:
    records, fit = left(of_noise)
    expected, _ = wandering_gain(records, fit, NOISE_UM)
    for record, e in zip(records, fit.residuals, strict=True):
        record.held_out = np.arange(TIME) >= 0.85 * TIME
        record.train = ~record.held_out
        e[record.held_out] += 0.1 * record.y[record.held_out]
        record.y[record.held_out] *= 1.1
    found, _ = wandering_gain(records, fit, NOISE_UM)
    assert found.probability == expected.probability == 0.0
    assert found.share < 0.1


@pytest.mark.parametrize("measured", [True, False])
def test_it_explains_its_share_but_is_no_complete_explanation(measured: bool) -> None:
    """It leaves a fifth of the mean square of the retuned stage, and a lag explains the rest."""
    records, fit = left(of_a_gain)
    fit.train_rms, retuned = 1.0, SimpleNamespace(train_rms=5**0.5)
    lag = NamedEffect("sensor_lag", "sensor", (), 0.9, (), 0.8 if measured else 1.0, "", "", ())
    before = Decision("partly_explained", (lag,), (), 0.2 if measured else 0.0, 0.0, None)
    noise = SimpleNamespace(rms_um=NOISE_UM) if measured else None
    found, adds = with_wandering_gain(before, records, retuned, fit, noise)
    assert found.verdict == "partly_explained"
    assert {one.name: one.share for one in found.effects} == pytest.approx(
        {"sensor_lag": 0.8, "gain_modulation": 0.2}, abs=0.03
    )
    assert sum(one.share for one in found.effects) + found.unexplained_share == pytest.approx(1.0)
    assert len(adds) == len(records)


def test_a_diagnosis_names_it_and_shows_what_it_adds() -> None:
    rng = np.random.default_rng(3)
    diagnosis = diagnose(pair(TIME, after=lambda x, fs_hz: x * (1 + GAIN * walk(rng))))
    assert [effect.name for effect in diagnosis.effects] == ["gain_modulation"]
    assert diagnosis.effects[0].form == "random walk"
    for trace in diagnosis.traces:
        assert np.corrcoef(trace.signatures["gain_modulation"], trace.residual_augmented)[0, 1] > 0.9


def test_a_gain_that_is_named_already_is_not_named_twice() -> None:
    records, fit = left(of_a_gain)
    effect, _ = wandering_gain(records, fit, NOISE_UM)
    before = Decision("partly_explained", (effect,), (), 0.1, 0.0, NOISE_UM)
    assert with_wandering_gain(before, records, fit, fit, None) == (before, [])
