"""What held-out samples say of a fit, a block at a time: no single block outvotes the others.

A stair that no training sample has visited may be missed by a hundred times the noise, whatever else the
model has or lacks. So every block counts by the ratio of its errors, not by their size.
"""

from collections.abc import Sequence

import numpy as np

from torchpi.diagnosis.hypothesis import Fit
from torchpi.diagnosis.records import Record

TINY_UM2 = 1e-30


def gain(records: Sequence[Record], better: Fit, worse: Fit) -> float:
    """By what share the error falls: the geometric mean over the blocks."""
    return 1.0 - typical_um(records, better) / typical_um(records, worse)


def typical_um(records: Sequence[Record], one: Fit) -> float:
    """The geometric mean of the blocks' rms errors; 0 where nothing is held out."""
    return typical_of(records, one.residuals)


def typical_of(records: Sequence[Record], residuals: Sequence[np.ndarray]) -> float:
    """The same of residuals, (time,) for each recording."""
    squares = squares_of(records, residuals)
    return float(np.exp(0.5 * np.log(squares).mean())) if len(squares) else 0.0


def explained(records: Sequence[Record], now: Fit, before: Fit) -> float:
    """Share of the squared error that is gone since `before`: the mean over the blocks, of -1 to 1 each."""
    after, first = mean_squares(records, now), mean_squares(records, before)
    return float(np.mean((first - after) / np.maximum(first, after)))


def unexplained(records: Sequence[Record], now: Fit, before: Fit, floor_um: float) -> float:
    """What `now` leaves above the floor, as a share of the squared error before: the mean over the blocks."""
    after, first = mean_squares(records, now), mean_squares(records, before)
    return max(0.0, float(np.mean((after - floor_um**2) / np.maximum(first, after))))


def mean_squares(records: Sequence[Record], one: Fit) -> np.ndarray:
    """(blocks,): of the held-out residual, µm²."""
    return squares_of(records, one.residuals)


def squares_of(records: Sequence[Record], residuals: Sequence[np.ndarray]) -> np.ndarray:
    """The same of residuals, (time,) for each recording."""
    return np.array(
        [
            np.mean(e[block] ** 2) + TINY_UM2
            for record, e in zip(records, residuals, strict=True)
            for block in record.held_out
        ]
    )
