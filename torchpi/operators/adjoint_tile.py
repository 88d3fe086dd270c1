"""Loops of the backward pass over one tile of a folded record, for one play.

All their values lie in one array `work`, each quantity at its own constant offset. The compiler thus knows
that the quantities do not overlap and need not check this before every loop.
"""

import numpy as np

from torchpi.operators.compiled import njit, njit_sum
from torchpi.operators.folded import LANES, STEPS, TILE
from torchpi.operators.play_equation import play

_play = njit(play)

_PLACE = TILE + LANES
S = 0  # the input of the plays
GS = 1 * _PLACE  # its gradient
H = 2 * _PLACE  # the states: LANES from before the tile, then those after each of its samples
GH = 3 * _PLACE  # the gradient of the latter
WAITING = 4 * _PLACE  # the part of GH that waits for a push; what is left for earlier tiles comes first
GAMMA = 5 * _PLACE  # γ_m = φ_m g of every function of the rate; first the gradient g of u itself


@njit
def work_size(functions: int) -> int:
    return GAMMA + functions * TILE


@njit_sum
def advance_dots(work: np.ndarray, r: float, count: int) -> tuple[float, float]:
    """Compute the states over a tile of `count` samples; return their dot products with γ_0 and γ_1."""
    first, second = work.dtype.type(0), work.dtype.type(0)
    for q in range(count):
        h = _play(work[S + q], r, work[H + q])
        work[H + LANES + q] = h
        first += work[GAMMA + q] * h
        second += work[GAMMA + TILE + q] * h
    return first, second


@njit
def land(work: np.ndarray, r: float, count: int) -> None:
    """Carry the gradient of the states back over a tile, to the samples that pushed.

    Every state is x_s - r or x_s + r of the last sample s that pushed it, or the initial state: the gradient
    waits while the play rests, and is added at the sample that pushed.
    """
    for step in range(STEPS - 1, -1, -1):
        for lane in range(LANES if step * LANES < count else 0):
            q = step * LANES + lane
            _land(work, r, q, work[GH + q])


@njit
def land_linear(work: np.ndarray, r: float, a: float, b: float, count: int) -> None:
    """`land` for the gradient a γ_0 + b γ_1, which then needs no pass of its own."""
    for step in range(STEPS - 1, -1, -1):
        for lane in range(LANES if step * LANES < count else 0):
            q = step * LANES + lane
            _land(work, r, q, a * work[GAMMA + q] + b * work[GAMMA + TILE + q])


@njit
def _land(work: np.ndarray, r: float, q: int, gradient: float) -> None:
    carried = gradient + work[WAITING + LANES + q]
    s, h = work[S + q], work[H + q]
    rests = (h > s - r) & (h < s + r)
    work[WAITING + q] = carried if rests else work.dtype.type(0)
    gs = work[GS + q]
    work[GS + q] = gs if rests else gs + carried
