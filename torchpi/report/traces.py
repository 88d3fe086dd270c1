"""Reduction of long traces to as many points as a picture can show, without losing a peak."""

from itertools import pairwise

import numpy as np
import numpy.typing as npt

Signal = npt.NDArray[np.float64]  # shape: (time,)


def envelope(t: Signal, y: Signal, columns: int = 800) -> tuple[Signal, Signal]:
    """Return the lowest and highest sample of every column, in order of time; short traces unchanged."""
    k = extremes(y, columns)
    return t[k], y[k]


def extremes(y: Signal, columns: int) -> npt.NDArray[np.intp]:
    """Return sorted indices of the lowest and highest sample of every column, and of the trace's two ends."""
    if len(y) <= 2 * columns:
        return np.arange(len(y))
    starts = np.linspace(0, len(y), columns + 1).astype(int)
    kept = [0, len(y) - 1]
    for start, stop in pairwise(starts):
        column = y[start:stop]
        kept += [start + int(np.argmin(column)), start + int(np.argmax(column))]
    return np.unique(kept)


def readable(y: Signal, most: int = 24) -> slice:
    """Return a middle stretch of `most` swings through the mean; the whole if there are at most 2·`most`.

    A swing goes from half a standard deviation above the mean to as much below it, or back.
    """
    away = y - y.mean()
    beyond = np.flatnonzero(np.abs(away) > 0.5 * y.std())
    swings = beyond[1:][np.diff(np.sign(away[beyond])) != 0]
    if len(swings) <= 2 * most:
        return slice(0, len(y))
    first = (len(swings) - most) // 2
    return slice(int(swings[first]), int(swings[first + most]))


def thinned(x: Signal, y: Signal, resolution: float = 1 / 1500, most: int = 6_000) -> tuple[Signal, Signal]:
    """Return a curve without samples that fall on the same dot as the one before; turning points are kept.

    Dots are enlarged until at most `most` samples remain.
    """
    kept = _off_the_dot(x, y, resolution)
    while kept.sum() > most and resolution < 0.1:
        resolution *= 1.5
        kept = _off_the_dot(x, y, resolution)
    return x[kept], y[kept]


def _off_the_dot(x: Signal, y: Signal, resolution: float) -> npt.NDArray[np.bool_]:
    dots_x = np.round((x - x.min()) / max(float(np.ptp(x)), 1e-12) / resolution)
    dots_y = np.round((y - y.min()) / max(float(np.ptp(y)), 1e-12) / resolution)
    moved = (np.diff(dots_x) != 0) | (np.diff(dots_y) != 0)
    kept = np.concatenate([[True], moved])
    kept[-1] = True
    return kept


def stretches(mask: Signal) -> list[tuple[int, int]]:
    """Return the stretches where the mask is true, as (first sample, sample after the last)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    return [(int(start), int(stop)) for start, stop in zip(edges[::2], edges[1::2], strict=True)]
