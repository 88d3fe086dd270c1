"""How late a stage turns round: the lag that a single record shows, whatever its loops are.

A hysteresis that does not follow the rate turns exactly where its input does, and next to a turning point the
displacement is one smooth function of the voltage before it, and another after it,

    y(t + d) = y_0 + Σ_{k ≤ 3} a_k (u(t) - u_0)^k   before,   y_0 + Σ_{k ≤ 3} b_k (u(t) - u_0)^k   after,

so that d is read at each turning point by itself. Creep goes on after a turning point and only ever adds to
d, not equally at both ends of the loops: the end where it is smaller is believed. The error of a fit to whole
loops cannot tell a lag: where all loops are equally large and fast, the width that it adds is that of plays
of other thresholds.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from torchpi.diagnosis.locate import turning_points
from torchpi.identification.pair import InversePair

LEAST_TURN = 0.1  # share of the voltage's span: of a reversal, and what is read on either side of it
DEGREE = 3
LEAST_SAMPLES = 4 * DEGREE  # on either side
MOST_SAMPLES = 200  # on either side, evenly over it
LEAST_TURNS, MOST_TURNS = 2, 60  # at each end
EARLIEST = -4  # samples: so that noise about a lag of none is not cut off
APART = 3  # samples: a single reversal is read about the lag that fits all of them best


class Lag(NamedTuple):
    """Of the displacement behind the voltage, samples: its mean over the reversals at that end of the loops
    where it is smaller, and the standard error of this mean."""

    mean: float
    standard_error: float


class _Reversal(NamedTuple):
    """The samples next to a turning point, and an orthonormal basis of what the displacement may be there."""

    rows: np.ndarray
    basis: np.ndarray
    latest: int  # samples: with a larger lag one side alone would be read as both
    upper: bool  # whether the voltage turns down

    def left(self, y: np.ndarray, lag: float) -> float:
        """The sum of squares that no function of the voltage explains at this lag."""
        late = np.interp(self.rows + lag, np.arange(len(y)), y)
        return float(np.square(late - self.basis @ (self.basis.T @ late)).sum())


def lag_at_reversals(pair: InversePair, most: int) -> Lag | None:
    """The lag of a record, up to `most` samples; None where either end has fewer than two to read."""
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
    """What is next to a turning point; None where it is too short, or too near an end of the record."""
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
