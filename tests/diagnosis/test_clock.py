"""What a clock that jitters hides: a lag of less than a sample."""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.diagnosis.plants import FS_HZ, hysteresis, multisine
from torchpi import Recording, diagnose
from torchpi.diagnosis.clock import at_their_ticks, depends_on_lateness, seen_early

SAMPLES = 1500
RNG = np.random.default_rng(3)
LATE_S = RNG.uniform(0.0, 0.1, SAMPLES) / FS_HZ


def record(u: np.ndarray, late_s: np.ndarray | None = LATE_S) -> SimpleNamespace:
    return SimpleNamespace(u=u, late_s=late_s, train=np.arange(len(u)) < 1300)


@pytest.mark.parametrize("next_step", [False, True])
def test_readings_that_see_more_of_a_step_the_later_they_are_depend_on_it(next_step: bool) -> None:
    u = multisine(SAMPLES)
    step = np.diff(u, append=u[-1:]) if next_step else np.diff(u, prepend=u[:1])
    e = 5 * LATE_S * FS_HZ * step + RNG.normal(0, 0.01, SAMPLES)
    assert depends_on_lateness([record(u)], [e])
    assert depends_on_lateness([record(u, None), record(u)], [e, e])
    assert not depends_on_lateness([record(u, None)], [e])


@pytest.mark.parametrize("seed", range(30))
def test_a_model_error_along_the_steps_depends_on_no_lateness(seed: int) -> None:
    """Whatever the model lacks, how late a reading was taken has nothing to do with it."""
    u, late_s = multisine(SAMPLES, seed=seed), np.random.default_rng(seed).uniform(0.0, 0.1, SAMPLES) / FS_HZ
    lag = 0.3 * np.diff(u, prepend=u[:1])
    assert not depends_on_lateness([record(u, late_s)], [lag + 0.1 * np.sin(u)])


def late(x: np.ndarray, share: np.ndarray) -> np.ndarray:
    return x + share * np.diff(x, append=x[-1:])


@given(st.integers(0, 10**6), st.floats(0.0, 0.5))
def test_readings_brought_back_to_their_ticks_have_seen_nothing_of_the_next_step(
    seed: int, most: float
) -> None:
    rng = np.random.default_rng(seed)
    x, share = rng.normal(size=200), rng.uniform(0, most, 200)
    np.testing.assert_allclose(at_their_ticks(late(x, share), share), x, atol=1e-9)


@pytest.mark.parametrize("per_tick", [1.0, 4.0])
def test_the_share_of_the_next_step_is_estimated_beside_a_lag_and_noise(per_tick: float) -> None:
    u = multisine(SAMPLES)
    x = hysteresis(u)
    share = per_tick * LATE_S * FS_HZ
    y = late(x, share) + RNG.normal(0, 0.002, SAMPLES)
    records = [SimpleNamespace(**vars(record(u)), y=y), SimpleNamespace(**vars(record(u, None)), y=y)]
    lag = 0.05 * np.diff(x, append=x[-1:])
    found, none = seen_early(records, [y - x + lag] * 2)
    np.testing.assert_allclose(found, share - share.min(), atol=0.01)
    assert not none.any()


def test_a_stage_whose_late_readings_see_the_next_step_is_explained_once_they_are_brought_back() -> None:
    """Without the correction 2.9 µm rms are left: the time stamps tell the lateness to within 2 % of its rms,
    as the rate of the clock has to be estimated from as few."""
    ticks, steps = np.arange(SAMPLES), np.random.default_rng(5).uniform(0, 100, SAMPLES // 10)
    u = np.repeat(steps, 10)
    y = late(hysteresis(u), 4 * LATE_S * FS_HZ) + np.random.default_rng(1).normal(0, 0.004, SAMPLES)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        jittering = Recording.from_arrays(ticks / FS_HZ + LATE_S, u, y, resample=True)
    found = diagnose([jittering])
    assert found.augmented.train_rms_um < 0.1
    assert not found.effects
    assert any("brought back to their ticks" in note for note in found.notes)


def test_a_lag_that_comes_from_a_jittering_clock_is_not_named_and_the_note_says_why() -> None:
    """Readings just before the next voltage is written, some of them late; the stage itself is quick."""
    u, ticks = multisine(SAMPLES, high_hz=400.0), np.arange(SAMPLES)
    before, after = hysteresis(np.concatenate([u[:1], u[:-1]])), hysteresis(u)
    seen = np.minimum(10 * LATE_S * FS_HZ, 1.0)
    y = (1 - seen) * before + seen * after + np.random.default_rng(1).normal(0, 0.004, SAMPLES)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        jittering = Recording.from_arrays(ticks / FS_HZ + LATE_S, u, y, resample=True)
    assert jittering.late_s is not None
    assert np.corrcoef(jittering.late_s, LATE_S)[0, 1] > 0.999
    found = diagnose([jittering])
    assert not {"sensor_lag", "amplifier_lag", "delay"} & {one.name for one in found.effects}
    assert any("how late their time stamps are" in note for note in found.notes)
