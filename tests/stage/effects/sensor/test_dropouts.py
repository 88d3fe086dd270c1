"""Dropouts: single wrong readings, read off the readings; what a stage does by itself is none."""

import numpy as np
import pytest
import scipy.signal
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.stage.effects.actuator.laws import PERIOD_S, EffectLaws
from torchpi.operators.conformance import wandering
from torchpi.stage.effects.effect import DataRange
from torchpi.stage.effects.sensor.dropouts import Dropouts

FS_HZ = 1e4
TIME = 20_000
T_S = np.arange(TIME) / FS_HZ
SINE_UM = 20 + 15 * np.sin(2 * np.pi * 3 * T_S)


class TestLaws(EffectLaws):
    differentiable = False

    def operator(self) -> Dropouts:
        return Dropouts(PERIOD_S, share=0.01)


def test_the_stage_predicts_no_wrong_readings():
    x = wandering(2, 50)
    assert torch.equal(Dropouts(1e-4, share=0.5)(x)[0], x)


def test_a_search_has_no_start_for_they_are_read_off():
    assert Dropouts.starts(DataRange(1e4, 1.0, 0, 1, 1, 0, 1, {})) == []


def noise(seed: int, kind: str) -> np.ndarray:
    generator = np.random.default_rng(seed)
    if kind == "normal":
        return generator.standard_normal(TIME)
    return generator.standard_t(float(kind), TIME)


def places(seed: int, count: int) -> np.ndarray:
    """Apart from each other by more than a run and its surroundings."""
    return np.sort(np.random.default_rng(seed).choice(np.arange(20, TIME - 20, 25), count, replace=False))


@given(
    seed=st.integers(0, 1000),
    count=st.sampled_from([1, 5, 60]),
    run=st.integers(1, 3),
    lsb_um=st.sampled_from([0.0, 0.006]),
)
def test_readings_of_zero_are_found_and_no_others(seed, count, run, lsb_um):
    y = SINE_UM + 0.004 * noise(seed, "normal")
    y = np.round(y / lsb_um) * lsb_um if lsb_um else y
    expected = np.concatenate([k + np.arange(run) for k in places(seed, count)])
    y[expected] = 0.0
    assert Dropouts.indices(y).tolist() == expected.tolist()


@given(seed=st.integers(0, 1000), size=st.sampled_from([0.4, -1.0, 30.0]))
def test_any_reading_a_hundred_times_the_noise_away_is_found(seed, size):
    y, expected = SINE_UM + 0.004 * noise(seed, "normal"), places(seed, 10)
    y[expected] += size
    assert Dropouts.indices(y).tolist() == expected.tolist()


@pytest.mark.parametrize("run", [1, 2, 3])
def test_the_last_reading_once_more_is_found_where_the_stage_moves_far_in_a_sample(run):
    y = 20 * np.sin(2 * np.pi * 40 * T_S) + 0.002 * noise(0, "normal")
    expected = np.array([k + m for k in 250 * np.arange(3, 40, 5) for m in range(run)])  # where it is fast
    for k in expected[::run]:
        y[k : k + run] = y[k - 1]
    assert set(Dropouts.indices(y).tolist()) == set(expected.tolist())


def test_heavy_tails_hide_small_dropouts_not_large_ones():
    y, expected = SINE_UM + 0.004 * noise(1, "3"), places(1, 8)
    y[expected] = 0.0
    assert Dropouts.indices(y).tolist() == expected.tolist()


@pytest.mark.parametrize("kind", ["normal", "5", "3", "2"])
@pytest.mark.parametrize("seed", range(4))
def test_noise_of_any_tail_has_none(kind, seed):
    assert Dropouts.indices(0.004 * noise(seed, kind)).tolist() == []
    assert Dropouts.indices(SINE_UM + 0.004 * noise(seed, kind)).tolist() == []


@pytest.mark.parametrize("noise_um", [0.0, 0.002])
@pytest.mark.parametrize("damping", [0.005, 0.03, 0.3, 0.7])
@pytest.mark.parametrize("frequency_hz", [300.0, 1000.0, 2500.0, 4000.0, 4900.0])
def test_steps_that_ring_have_none(frequency_hz, damping, noise_um):
    omega = 2 * np.pi * frequency_hz
    mode = scipy.signal.lti([omega**2], [1, 2 * damping * omega, omega**2])
    held = np.sign(np.sin(2 * np.pi * 5 * T_S + 1e-3))
    _, y, _ = scipy.signal.lsim(mode, held, T_S, interp=False)
    assert Dropouts.indices(y + noise_um * noise(2, "normal")).tolist() == []


@pytest.mark.parametrize("noise_um", [0.0, 0.003])
@pytest.mark.parametrize("lsb_um", [0.0, 0.01, 1.0])
def test_stairs_corners_jumps_and_edges_have_none(noise_um, lsb_um):
    generator = np.random.default_rng(5)
    shapes = {
        "stairs": np.floor(40 * T_S),
        "triangle": 20 * np.abs(7 * T_S % 1 - 0.5),
        "edges": np.sign(np.sin(2 * np.pi * 300 * T_S + 0.1)),
        "jumps": np.cumsum((generator.random(TIME) < 0.003) * generator.standard_normal(TIME)),
        "fast sine": np.sin(2 * np.pi * 4700 * T_S),
        "rest": np.full(TIME, 3.0),
    }
    for name, shape in shapes.items():
        y = shape + noise_um * noise(3, "normal")
        assert Dropouts.indices(np.round(y / lsb_um) * lsb_um if lsb_um else y).tolist() == [], name


@given(st.lists(st.floats(-1e6, 1e6), max_size=200))
def test_any_readings_have_an_answer(values):
    found = Dropouts.indices(np.array(values))
    assert found.dtype == np.int64 and (np.diff(found) > 0).all()
