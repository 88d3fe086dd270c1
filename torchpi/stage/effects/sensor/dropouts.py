"""Single wrong readings: a lost sample read as 0, as the last one, or as anything, one to three in a row.

They are read off the readings, as outliers from a smooth curve through the samples around them: additive
outliers (Fox, *Outliers in time series*, J. Royal Statistical Society B 34(3), 1972). A run of readings is
wrong where each lies off the cubic through two samples on either side by much more than the roughness (second
differences) that is left around it once the cubic stands in its place. A step, a corner or a ring leaves a
roughness of the same size, whatever replaces its samples; a wrong reading leaves none.

How much more follows from the record: the ratios' tail is taken for a power law (Hill, *A simple general
approach to inference about the tail of a distribution*, Annals of Statistics 3(5), 1975), and the threshold
is where noise of that tail is passed by `EXPECTED` samples of the whole record. So heavy tails are noise.
"""

import math
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from torchpi.operators.quantity import Quantity
from torchpi.stage.effects.effect import DataRange, Effect, Parameters

LONGEST_RUN = 3
REACH = 6
"""Samples on either side whose roughness counts."""
EXPECTED = 0.01
"""False alarms in a record."""
LEAST, MOST = 8.0, 100.0
"""Bounds of the threshold: a ring near half of the sample rate reaches 4, without noise; noise of two degrees
of freedom 30 in 20,000 samples. A tail of few different ratios may lead anywhere."""
FEWEST = 64
"""Readings; a tail takes some."""
FLOAT32_STEP = 2.0**-23


class Dropouts(Effect):
    """Readings that are not of the stage. Nothing predicts them: the output is the input, whatever the share.

    `share` is how many of the readings are wrong, for the report; `indices` finds them.
    """

    name = "dropouts"
    block = "sensor"
    equation = "y(k) = anything at a few k, else x(k)"
    signature = "single readings far off both of their neighbours"
    read_off = True
    unseen = "no single reading lies far off its neighbours"
    quantities: ClassVar[dict[str, Quantity]] = {"share": Quantity("", at_least=0.0, at_most=1.0)}
    identity: ClassVar[Parameters] = {"share": 0.0}
    per_recording = ("share",)
    share: nn.Parameter

    def forward(
        self,
        x: Tensor,  # (batch, time), µm
        state: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        return x, self.initial_state(len(x)) if state is None else state

    def stream(self) -> nn.Module:
        return DropoutsStream()

    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        return dx

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        return []

    @staticmethod
    def indices(
        readings: np.ndarray,  # (time,), any unit
    ) -> np.ndarray:  # (wrong,), rising
        """Where single readings are wrong, in runs of at most three.

        Nothing is found at the first and the last two readings, in fewer than 64, nor where more than about
        one reading in a hundred is wrong; of three runs within six samples the middle one may stay hidden.
        """
        y = np.array(readings, dtype=np.float64)
        if len(y) < FEWEST:
            return np.zeros(0, np.int64)
        wrong, resolution = np.zeros(len(y), bool), _resolution(y)
        # First a tail that single readings hardly touch, then a sharper one from what they leave.
        for many, few in ((0.1 * len(y), 0.01 * len(y)), (200.0, 20.0)):
            if many > 0.1 * len(y):
                break
            for run in range(1, LONGEST_RUN + 1):
                ratio, middle = _ratios(y, run, resolution)
                for k in np.flatnonzero(ratio > _threshold(ratio, many, few)):
                    wrong[k : k + run] = True
                    y[k : k + run] = middle[:, k]
        return np.flatnonzero(wrong)


class DropoutsStream(nn.Module):
    """Nothing, one sample at a time."""

    @torch.jit.export
    def reset(self) -> None:
        return

    @torch.jit.export
    def step(self, x: float) -> float:
        return x


def _resolution(y: np.ndarray) -> float:
    """What two readings differ by at least, or their file."""
    moved = np.abs(np.diff(y))
    smallest = float(moved[moved > 0].min(initial=math.inf))
    return max(smallest, 4 * FLOAT32_STEP * float(np.abs(y).max()))


def _ratios(y: np.ndarray, run: int, resolution: float) -> tuple[np.ndarray, np.ndarray]:
    """For a run from each sample on, how far it lies off its surroundings over their roughness, (time,), and
    the cubic in its place, (run, time)."""
    # Not at the top: half a second of import that a stage does not need.
    import scipy.ndimage

    count = len(y)
    first = np.arange(2, count - run - 1)
    around = np.stack([y[first - 2], y[first - 1], y[first + run], y[first + run + 1]])
    at = np.array([-2.0, -1.0, run, run + 1.0])
    powers = np.vander(np.arange(float(run)), 4) @ np.linalg.inv(np.vander(at, 4))
    middle = powers @ around
    off = np.abs(np.stack([y[first + m] for m in range(run)]) - middle).min(0)
    replaced = np.concatenate([around[:2], middle, around[2:]])
    rough = np.zeros(count)
    rough[1:-1] = np.abs(np.diff(y, 2))
    widest = scipy.ndimage.maximum_filter1d(rough, REACH, mode="constant")
    # Second differences that do not touch the run: the filter reaches REACH / 2 back, and 1 less ahead.
    left = np.clip(first - 1 - REACH // 2, 0, None)
    right = np.clip(first + run + 1 + REACH // 2, None, count - 1)
    rest = np.maximum(np.abs(np.diff(replaced, 2, axis=0)).max(0), np.minimum(widest[left], widest[right]))
    ratio, placed = np.zeros(count), np.zeros((run, count))
    ratio[first] = off / np.maximum(rest, resolution)
    placed[:, first] = middle
    return ratio, placed


def _threshold(ratio: np.ndarray, many: float, few: float) -> float:
    """What `EXPECTED` ratios of the whole record pass, by the power law through those that `many` and `few`
    of them pass."""
    low, high = np.quantile(ratio, [1 - many / len(ratio), 1 - few / len(ratio)])
    if not 0 < low < high:
        return MOST if high > LEAST else LEAST
    exponent = math.log(many / few) / math.log(high / low)
    tail = math.log(high) + math.log(few / EXPECTED) / exponent
    return math.exp(min(max(tail, math.log(LEAST)), math.log(MOST)))
