"""Influence of the unknown history before the first sample, as columns whose weights enter linearly.

By the wiping-out property (Mayergoyz, *Mathematical Models of Hysteresis and their Applications*, 2003) a
hysteresis forgets its past where the input passes the extremes that it has stored. The contribution of the
history to the displacement thus depends only on the largest excursions since the first sample: it is a
function of the running excursion, upward or either way, here piecewise linear and 0 at the largest one.

A hysteresis without wiping-out forgets along its path instead: the initial state of dz = α|dv|(f(v) - z)
fades as e^{-α s} with the path s = ∫|dv| (Duhem; Visintin, *Differential Models of Hysteresis*, 1994).
"""

import numba
import numpy as np

EITHER, UP = np.linspace(0, 1, 15)[1:] ** 1.5, np.linspace(0, 1, 6)[1:]
"""Excursions either way, and upward, at which one of the columns ends, as shares of the largest excursion."""
COLUMNS = len(EITHER) + len(UP)


def excursions(v: np.ndarray) -> np.ndarray:
    """(columns, time) for a voltage, (time,): each is 1 at first, 0 once an excursion passes its level."""
    columns = np.zeros((COLUMNS, len(v)))
    reach = max(float(np.abs(v - v[0]).max()), 1e-300)
    _fill(v, reach * EITHER, reach * UP, columns)
    return columns


def fading(v: np.ndarray, alpha_per_v: float) -> np.ndarray:
    """(time,) for a voltage, (time,): e^{-α s} along its path."""
    faded: np.ndarray = np.exp(-alpha_per_v * np.cumsum(np.abs(np.diff(v, prepend=v[0]))))
    return faded


@numba.njit(cache=True)
def _fill(v: np.ndarray, either: np.ndarray, up: np.ndarray, columns: np.ndarray) -> None:
    highest, largest, past_either, past_up = 0.0, 0.0, 0, 0
    for t in range(len(v)):
        highest = max(highest, v[t] - v[0])
        largest = max(largest, abs(v[t] - v[0]))
        while past_either < len(either) and largest >= either[past_either]:
            past_either += 1
        while past_up < len(up) and highest >= up[past_up]:
            past_up += 1
        for i in range(past_either, len(either)):
            columns[i, t] = 1.0 - largest / either[i]
        for i in range(past_up, len(up)):
            columns[len(either) + i, t] = 1.0 - highest / up[i]
