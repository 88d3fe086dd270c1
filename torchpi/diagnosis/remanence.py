"""What a recording remembers from before its first sample, as columns that are linear in what is not known.

By wiping-out (Mayergoyz, *Mathematical Models of Hysteresis and their Applications*, 2003) a hysteresis
forgets its past where the input passes the extremes that it has stored: what a history adds to the
displacement depends on the largest excursions since the first sample alone, and ends where they are largest.
So it is a function of the running excursion, up or either way, here piecewise linear and 0 at its end.
"""

import numpy as np

EITHER, UP = np.linspace(0, 1, 15)[1:] ** 1.5, np.linspace(0, 1, 6)[1:]
"""Excursions either way, and up, of the largest, at which one of the columns ends."""
COLUMNS = len(EITHER) + len(UP)


def remanence(v: np.ndarray) -> np.ndarray:
    """(COLUMNS, time) for a voltage, (time,): 1 at first, 0 once an excursion has passed its level."""
    up, down = np.maximum.accumulate(v - v[0]), np.maximum.accumulate(v[0] - v)
    either = np.maximum(up, down)
    reach = max(float(either[-1]), 1e-300)
    columns = np.empty((COLUMNS, len(v)))
    for row, level in zip(columns, EITHER, strict=False):
        np.maximum(0.0, 1.0 - either / (level * reach), out=row)
    for row, level in zip(columns[len(EITHER) :], UP, strict=True):
        np.maximum(0.0, 1.0 - up / (level * reach), out=row)
    return columns
