"""Estimate the lag of a stage at the reversals of a single record, whatever the shape of its loops.

A rate-independent hysteresis reverses exactly where its input does. Near a turning point, the displacement is
one smooth function of the voltage before it, and another after it,

    y(t + d) = y_0 + Σ_{k ≤ 3} a_k (u(t) - u_0)^k   before,   y_0 + Σ_{k ≤ 3} b_k (u(t) - u_0)^k   after,

so d can be estimated at each turning point by itself. Creep continues after a turning point and only ever
adds to d, by different amounts at the two ends of the loops; the end where d is smaller is trusted. The error
of a fit to whole loops cannot reveal a lag: if all loops are equally large and fast, the width that a lag
adds is that of plays with other thresholds.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from torchpi.diagnosis.locate import turning_points
from torchpi.identification.pair import InversePair

LEAST_TURN = 0.1  # share of the voltage's span: depth of a reversal, and of the part used on either side
DEGREE = 3
LEAST_SAMPLES = 4 * DEGREE  # on either side
MOST_SAMPLES = 200  # on either side, evenly spread
LEAST_TURNS, MOST_TURNS = 2, 60  # reversals at each end of the loops
EARLIEST = -4  # samples: negative, so that noise around a lag of zero is not cut off
APART = 3  # samples: range of a single reversal's lag around the lag that fits all of them best


class Lag(NamedTuple):
    """Lag of the displacement behind the voltage, samples: its mean over the reversals at that end of the
    loops where it is smaller, and the standard error of this mean."""

    mean: float
    standard_error: float


class _Reversal(NamedTuple):
    """The samples next to a turning point, and an orthonormal basis of the possible displacements there."""

    rows: np.ndarray
    basis: np.ndarray
    latest: int  # samples: at a larger lag, one side alone would be taken for both
    upper: bool  # whether the voltage turns down

    def left(self, y: np.ndarray, lag: float) -> float:
        """Return the sum of squares that no function of the voltage explains at this lag."""
        late = np.interp(self.rows + lag, np.arange(len(y)), y)
        return float(np.square(late - self.basis @ (self.basis.T @ late)).sum())


def lag_at_reversals(pair: InversePair, most: int) -> Lag | None:
    """Return the lag, up to `most` samples; None if either end has fewer than two usable reversals."""
    u, y = pair.u[0].numpy(), pair.motion.yd[0].numpy()
    depth = LEAST_TURN * float(np.ptp(u))
    turns = [int(turn) for turn in turning_points(u, depth)[1:] if turn >= pair.counted.start]
    some = np.linspace(0, len(turns) - 1, min(len(turns), 2 * MOST_TURNS)).astype(int)
    read = [one for k in some if (one := _reversal(u, turns[k], depth, most)) is not None]
    ends = [[one for one in read if one.upper], [one for one in read if not one.upper]]
    if min(map(len, ends)) < LEAST_TURNS:
        return None
    lags = range(EARLIEST, min(one.latest for one in read) + 1)
    best = lags[int(np.argmin([sum(one.left(y, lag) for one in read) for lag in lags]))]
    if best in (lags[0], lags[-1]):
        return None
    return min(_mean(end, y, best) for end in ends)


def _mean(end: Sequence[_Reversal], y: np.ndarray, about: int) -> Lag:
    bounds = about - APART, about + APART
    each = [minimize_scalar(lambda lag, at=at: at.left(y, lag), bounds=bounds).x for at in end]
    return Lag(float(np.mean(each)), float(np.std(each, ddof=1) / np.sqrt(len(each))))


def _reversal(u: np.ndarray, turn: int, depth: float, most: int) -> _Reversal | None:
    """Return the samples next to a turning point; None if too few, or too near an end of the record."""
    away = np.abs(u - u[turn]) > depth
    before, after = np.flatnonzero(away[:turn]), turn + np.flatnonzero(away[turn:])
    if len(before) == 0 or len(after) == 0:
        return None
    first, last = int(before[-1]) + 1, int(after[0])
    shorter = min(turn - first, last - turn)
    latest = min(most, shorter // 2)
    if shorter < LEAST_SAMPLES or first + EARLIEST < APART or last + latest + APART > len(u):
        return None
    sides = np.linspace(first, turn, MOST_SAMPLES), np.linspace(turn, last - 1, MOST_SAMPLES)
    rows = np.unique(np.concatenate(sides).astype(int))
    powers = ((u[rows] - u[turn]) / depth)[:, None] ** np.arange(1, DEGREE + 1)
    past = (rows > turn)[:, None]
    basis, _ = np.linalg.qr(np.column_stack([np.ones(len(rows)), powers * ~past, powers * past]))
    return _Reversal(rows, basis, latest, upper=bool(u[first] < u[turn]))
