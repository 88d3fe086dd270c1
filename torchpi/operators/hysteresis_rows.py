"""Elementary hysteresis states as rows, (states, time): what a search over nominal hysteresis needs fast.

Three families, each linear in its weights once the rows stand:

- generalised plays, h = max{v_up - r, min{v_down + r, h}}: Prandtl–Ishlinskii, and Preisach in play form
  (Brokate and Sprekels 1996), y = Σ f_i(h_i), through output functions f_i that are piecewise linear: sums of
  h_i and of hinges, each the part of h_i beyond a kink. They go on straight beyond what was recorded, where
  powers diverge, and they follow a density that changes fast;
- Bouc–Wen, dz/dv = 1/σ [1 - |z|ⁿ (γ + β sgn(z dv))], β + γ = 1 (Ikhouane and Rodellar, 2007, normalised);
- a bank of Duhem states after Coleman and Hodgdon (1986), dz = α|dv| (f(v) - z) with f a power of v: loops
  that move as they are repeated, which plays never do.
"""

import math
from typing import Any

import numba
import numpy as np

from torchpi.operators.generalised_play import clamp_play

_clamp_play: Any = numba.njit(clamp_play)
TOGETHER = 128
"""Samples of many sums that are written at a time: they stay in the cache."""
DUHEM_BANK = tuple((times, power) for times in (1.0, 3.0, 10.0, 30.0, 100.0) for power in (1, 2, 3, 4))
"""Of each state of a bank its α over the smallest, and the power of v: any α in between, and any smooth f, is
all but a sum of these."""


def bend(v: float, asymmetry_per_v: float) -> float:
    """How far the envelope up lies above v, and that down below it: a v². Tensors pass as well."""
    return asymmetry_per_v * v * v


def gain_inside(v: float, rate: float, incongruence_per_v: float, weight_s_per_v: float) -> float:
    """(1 + κ v)(1 + k v̇): what multiplies the states that have memory. Tensors pass as well."""
    return (1.0 + incongruence_per_v * v) * (1.0 + weight_s_per_v * rate)


def straight_gain(gain: float, straight_share: float) -> float:
    """1 - q (g - 1): what multiplies v itself, which so keeps the chord of the loop. Tensors pass as well."""
    return 1.0 - straight_share * (gain - 1.0)


def threshold_widening(rate: float, threshold_s_per_v: float) -> float:
    """1 + β |v̇|: what multiplies the thresholds. Tensors pass as well."""
    return 1.0 + threshold_s_per_v * abs(rate)


def loop_widening(rate: float, loop_per_e: float, reference_rate_v_s: float) -> float:
    """γ ln(1 + |v̇| / v̇₀): the share by which a state moves away from c v, the chord of the loop."""
    return loop_per_e * math.log1p(abs(rate) / reference_rate_v_s)


def bouc_wen(z: float, dv: float, sigma: float, beta: float, n: float) -> float:
    """z after a straight move of dv, by the midpoint rule in pieces of σ/20 at most."""
    pieces = int(abs(dv) / sigma * 20.0) + 1
    move = dv / pieces
    for _ in range(pieces):
        at = z
        for part in (0.5, 1.0):
            sign = 1.0 if at * move >= 0.0 else -1.0
            at = z + part * move / sigma * (1.0 - abs(at) ** n * (1.0 - beta + beta * sign))
        z = at
    return z


def duhem(z: float, v: float, before: float, alpha: float, power: int) -> float:
    """z after a straight move from `before` to v, exact for f taken at the middle of the move."""
    middle = 0.5 * (v + before)
    target = 1.0
    for _ in range(power):
        target = target * middle
    return z + (target - z) * -math.expm1(-alpha * abs(v - before))


def hinge(x: float, kink: float) -> float:
    """The part of x beyond a kink, away from 0: each output function is 0 there."""
    return max(x - kink, 0.0) if kink >= 0.0 else min(x - kink, 0.0)


_hinge: Any = numba.njit(hinge)
_bouc_wen: Any = numba.njit(bouc_wen)
_duhem: Any = numba.njit(duhem)


@numba.njit(cache=True, error_model="numpy")
def play_states(
    chord: np.ndarray, up: np.ndarray, down: np.ndarray, r: np.ndarray, widening: np.ndarray,
    gain: np.ndarray, straight: np.ndarray, loop: np.ndarray, kinks: np.ndarray, h: np.ndarray, x: np.ndarray,
) -> None:  # fmt: skip
    """Into `x`, (time, 1 + kinks, plays): states h of max{up - r w, min{down + r w, h}}, then their hinges.

    States with memory take the gain, v itself `straight`, all the widening of the loop about its chord; all
    are (time,). `h`, (plays,), is where they start and where they end.
    """
    for t in range(len(up)):
        rising, falling, width = up[t], down[t], widening[t]
        grown, kept, looped, middle = gain[t], straight[t], loop[t], chord[t]
        for i in range(len(r)):
            h[i] = _clamp_play(rising - r[i] * width, falling + r[i] * width, h[i])
        first = x[t, 0]
        for i in range(len(r)):
            state = h[i] * (grown if r[i] > 0.0 else kept)
            first[i] = state + (state - middle) * looped
        for k in range(len(kinks)):
            beyond = x[t, k + 1]
            for i in range(len(r)):
                beyond[i] = _hinge(first[i], kinks[k])


@numba.njit(cache=True, fastmath={"reassoc"}, error_model="numpy")
def play_sum(
    chord: np.ndarray, up: np.ndarray, down: np.ndarray, r: np.ndarray, widening: np.ndarray,
    gain: np.ndarray, straight: np.ndarray, loop: np.ndarray, kinks: np.ndarray, weights: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """(time,): the weighted sum of the states and hinges of `play_states`, without the rows.

    Seven times as fast as one play after another: the loop over plays runs in vector registers, and sums in
    any order.
    """
    y, h = np.empty(len(up)), np.zeros(len(r))
    x, term = np.empty(len(r)), np.empty(len(r))
    for t in range(len(up)):
        rising, falling, width = up[t], down[t], widening[t]
        for i in range(len(r)):
            h[i] = _clamp_play(rising - r[i] * width, falling + r[i] * width, h[i])
        grown, kept, looped, middle, total = gain[t], straight[t], loop[t], chord[t], 0.0
        for i in range(len(r)):
            state = h[i] * (grown if r[i] > 0.0 else kept)
            x[i] = state + (state - middle) * looped
            term[i] = weights[0, i] * x[i]
        for k in range(len(kinks)):
            kink = kinks[k]
            if kink >= 0.0:
                for i in range(len(r)):
                    term[i] += weights[k + 1, i] * max(x[i] - kink, 0.0)
            else:
                for i in range(len(r)):
                    term[i] += weights[k + 1, i] * min(x[i] - kink, 0.0)
        for i in range(len(r)):
            total += term[i]
        y[t] = total
    return y


@numba.njit(cache=True, error_model="numpy")
def sums_of_plain_plays(
    v: np.ndarray, r: np.ndarray, kinks: np.ndarray, weights: np.ndarray, y: np.ndarray
) -> None:
    """Into `y`, (sums, time): the sums of `play_sum`, of plays max{v - r, min{v + r, h}} from 0.

    The plays that move with v are those of the smallest thresholds, and they move alike: their share is
    straight in v, offset + slope v, until one of them passes a kink or the next play begins to move. A step
    costs as much as these events, not as much as there are plays.

    Args:
        v: (time,).
        r: (plays,), ascending.
        kinks: Ascending.
        weights: (1 + kinks, plays, sums).
        y: What is written.
    """
    _, plays, sums = weights.shape
    slopes, offsets = _pieces(kinks, weights)
    h, still, offset, slope = np.zeros(plays), np.zeros(sums), np.zeros(sums), np.zeros(sums)
    piece, block = np.zeros(plays, np.int64), np.empty((TOGETHER, sums))
    moving, sign, before, passed = 0, 1.0, 0.0, np.inf
    for first in range(0, len(v), TOGETHER):
        stop = min(first + TOGETHER, len(v))
        for t in range(first, stop):
            now = v[t]
            if (now - before) * sign < 0.0:
                for i in range(moving):
                    h[i] = before - sign * r[i]
                for s in range(sums):
                    still[s] += offset[s] + slope[s] * before
                    offset[s], slope[s] = 0.0, 0.0
                moving, sign, passed = 0, -sign, np.inf
            if sign * now >= passed:
                passed = np.inf
                for i in range(moving):
                    state, old = now - sign * r[i], piece[i]
                    piece[i] = _piece_of(state, kinks, old)
                    if piece[i] != old:
                        for s in range(sums):
                            turned = slopes[piece[i], i, s] - slopes[old, i, s]
                            offset[s] += offsets[piece[i], i, s] - offsets[old, i, s] - sign * r[i] * turned
                            slope[s] += turned
                    passed = min(passed, _next_kink(piece[i], kinks, sign) + r[i])
            while moving < plays and sign * (now - h[moving]) > r[moving]:
                state, old = h[moving], _piece_of(h[moving], kinks, 0)
                piece[moving] = _piece_of(now - sign * r[moving], kinks, old)
                for s in range(sums):
                    still[s] -= offsets[old, moving, s] + slopes[old, moving, s] * state
                    gained = slopes[piece[moving], moving, s]
                    offset[s] += offsets[piece[moving], moving, s] - sign * r[moving] * gained
                    slope[s] += gained
                passed = min(passed, _next_kink(piece[moving], kinks, sign) + r[moving])
                moving += 1
            for s in range(sums):
                block[t - first, s] = still[s] + (offset[s] + slope[s] * now)
            before = now
        for s in range(sums):
            for t in range(first, stop):
                y[s, t] = block[t - first, s]


@numba.njit(cache=True)
def _pieces(kinks: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slope and offset of the output functions between two kinks, each (1 + kinks, plays, sums)."""
    slopes, offsets = np.zeros(weights.shape), np.zeros(weights.shape)
    for piece in range(len(kinks) + 1):
        slopes[piece] += weights[0]
        for k in range(len(kinks)):
            if k < piece if kinks[k] >= 0.0 else k >= piece:
                slopes[piece] += weights[k + 1]
                offsets[piece] -= kinks[k] * weights[k + 1]
    return slopes, offsets


@numba.njit(cache=True, inline="always")
def _piece_of(x: float, kinks: np.ndarray, near: int) -> int:
    """How many kinks are at x or below, from a guess."""
    piece = near
    while piece < len(kinks) and kinks[piece] <= x:
        piece += 1
    while piece > 0 and kinks[piece - 1] > x:
        piece -= 1
    return piece


@numba.njit(cache=True, inline="always")
def _next_kink(piece: int, kinks: np.ndarray, sign: float) -> float:
    """Where a piece ends for a state that moves on, times the sign of its way."""
    if sign > 0.0:
        return kinks[piece] if piece < len(kinks) else np.inf
    return -kinks[piece - 1] if piece > 0 else np.inf


@numba.njit(cache=True)
def bouc_wen_row(v: np.ndarray, sigma: float, beta: float, n: float, start: float) -> np.ndarray:
    """(time,), z from v = 0, where it was `start`."""
    row = np.empty(len(v))
    z, before = start, 0.0
    for t in range(len(v)):
        z = _bouc_wen(z, v[t] - before, sigma, beta, n)
        row[t] = z
        before = v[t]
    return row


@numba.njit(cache=True)
def duhem_row(v: np.ndarray, alpha: float, power: int) -> np.ndarray:
    """(time,), z from v = 0, where it was 0."""
    row = np.empty(len(v))
    z, before = 0.0, 0.0
    for t in range(len(v)):
        z = _duhem(z, v[t], before, alpha, power)
        row[t] = z
        before = v[t]
    return row


@numba.njit(cache=True)
def smooth(x: np.ndarray, decay: float) -> np.ndarray:
    """(time,) through a first-order low-pass from rest."""
    y = np.empty(len(x))
    state = 0.0
    for t in range(len(x)):
        state = decay * state + (1.0 - decay) * x[t]
        y[t] = state
    return y
