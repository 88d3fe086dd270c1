"""The slowest of several records has the weight of one repetition if it repeats one motion."""

import numpy as np
import pytest
import torch

from tests.identification.test_fits import PERIOD, wandering
from torchpi.identification import InversePair
from torchpi.identification.repetitions import repetitions, weighted_by_repetitions
from torchpi.operators.motion import Motion

T = PERIOD * np.arange(6000)


def sine(hz: float) -> np.ndarray:
    return 2 - 2 * np.cos(2 * np.pi * hz * T)


def record(y: np.ndarray) -> InversePair:
    parts = (y, np.gradient(y, PERIOD), np.gradient(np.gradient(y, PERIOD), PERIOD))
    motion = Motion(*(torch.from_numpy(part)[None] for part in parts))
    return InversePair("", motion, torch.from_numpy(y)[None], slice(0, None), PERIOD)


@pytest.mark.parametrize("hz", [0.5, 1.0, 1.37, 7.3])
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_the_repetitions_of_a_periodic_record_are_its_number_of_periods(hz: float, noise: float) -> None:
    y = sine(hz) + noise * np.random.default_rng(0).standard_normal(len(T))
    assert repetitions(y) == pytest.approx(6.0 * hz, rel=0.02)


@pytest.mark.parametrize(
    "y",
    [
        wandering(0, 6000).yd[0].numpy(),
        sine(1.0) * np.exp(-T / 5),  # neighbouring cycles are alike, the first and the last are not
        np.where(T < 3, sine(1.0), 0.5 * sine(2.0)),  # two motions, each repeated
        sine(0.25),  # a loop and a half
        T,
        np.zeros(6000),
    ],
    ids=["wandering", "decaying", "two motions", "less than two loops", "a ramp", "at rest"],
)
def test_a_record_that_does_not_repeat_one_motion_to_its_end_has_one_repetition(y: np.ndarray) -> None:
    assert repetitions(y) == 1.0


def test_the_slowest_of_several_records_has_the_weight_of_one_repetition() -> None:
    slow, fast, other = record(sine(1.0)), record(sine(5.0)), record(wandering(0, 6000).yd[0].numpy())
    assert [one.weight for one in weighted_by_repetitions([fast, slow, other])] == pytest.approx(
        [1.0, 1 / 6, 1.0], rel=0.01
    )
    assert [one.weight for one in weighted_by_repetitions([slow])] == [1.0]
