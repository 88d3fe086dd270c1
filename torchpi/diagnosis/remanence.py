"""Influence of the unknown history before the first sample, as columns whose weights enter linearly.

By the wiping-out property (Mayergoyz, *Mathematical Models of Hysteresis and their Applications*, 2003) a
hysteresis forgets its past where the input passes the extremes that it has stored. The contribution of the
history to the displacement thus depends only on the largest excursions since the first sample: it is a
function of the running excursion upward, downward or either way, here piecewise linear and 0 at the largest
one. A play whose state lies above the first input is reset by an upward excursion later than by a downward
one.

A hysteresis without wiping-out forgets along its path instead: the initial state of dz = α|dv|(f(v) - z)
fades as e^{-α s} with the path s = ∫|dv| (Duhem; Visintin, *Differential Models of Hysteresis*, 1994).
"""

import numba
import numpy as np

EITHER, ONE_WAY = np.linspace(0, 1, 15)[1:] ** 1.5, np.linspace(0, 1, 6)[1:]
"""Excursions either way, and upward or downward, at which one of the columns ends, as shares of the largest
excursion of that kind."""
COLUMNS = len(EITHER) + 2 * len(ONE_WAY)


def excursions(v: np.ndarray) -> np.ndarray:
    """(columns, time) for a voltage, (time,): each is 1 at first, 0 once an excursion passes its level.

    The columns of a direction in which the voltage never moves are 0. In a hold nothing is forgotten.
    """
    up = np.maximum.accumulate(v - v[0])
    down = np.maximum.accumulate(v[0] - v)
    columns, first = np.zeros((COLUMNS, len(v))), 0
    for excursion, shares in ((np.maximum(up, down), EITHER), (up, ONE_WAY), (down, ONE_WAY)):
        if excursion[-1] > 0 or shares is EITHER:
            _fall(excursion, max(excursion[-1], 1e-300) * shares, columns[first : first + len(shares)])
        first += len(shares)
    return columns


def fading(v: np.ndarray, alpha_per_v: float) -> np.ndarray:
    """(time,) for a voltage, (time,): e^{-α s} along its path."""
    faded: np.ndarray = np.exp(-alpha_per_v * np.cumsum(np.abs(np.diff(v, prepend=v[0]))))
    return faded


@numba.njit(cache=True)
def _fall(excursion: np.ndarray, levels: np.ndarray, columns: np.ndarray) -> None:
    for i in range(len(levels)):
        for t in range(np.searchsorted(excursion, levels[i])):
            columns[i, t] = 1.0 - excursion[t] / levels[i]
