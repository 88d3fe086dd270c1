"""Long traces made short for the eye: as many points as a picture can show, and no peak lost."""

from itertools import pairwise

import numpy as np
import numpy.typing as npt

Signal = npt.NDArray[np.float64]  # shape: (time,)


def envelope(t: Signal, y: Signal, columns: int = 800) -> tuple[Signal, Signal]:
    """The lowest and the highest sample of every column, in order of time; short traces pass whole."""
    if len(y) <= 2 * columns:
        return t, y
    starts = np.linspace(0, len(y), columns + 1).astype(int)
    kept = [0, len(y) - 1]
    for start, stop in pairwise(starts):
        column = y[start:stop]
        kept += [start + int(np.argmin(column)), start + int(np.argmax(column))]
    k = np.unique(kept)
    return t[k], y[k]


def thinned(x: Signal, y: Signal, resolution: float = 1 / 1500) -> tuple[Signal, Signal]:
    """A curve without the samples that fall on the dot of the one kept before; turning points stay."""
    dots_x = np.round((x - x.min()) / max(float(np.ptp(x)), 1e-12) / resolution)
    dots_y = np.round((y - y.min()) / max(float(np.ptp(y)), 1e-12) / resolution)
    moved = (np.diff(dots_x) != 0) | (np.diff(dots_y) != 0)
    kept = np.concatenate([[True], moved])
    kept[-1] = True
    return x[kept], y[kept]
