"""Fast elementary hysteresis states as rows, (states, time), for a search over nominal hysteresis.

Three families, each linear in its weights once the rows are computed:

- generalised plays (Prandtl–Ishlinskii, and Preisach in play form through output functions),
  h = max{v_up - r, min{v_down + r, h}};
- Bouc–Wen, dz/dv = 1/σ [1 - |z|ⁿ (γ + β sgn(z dv))], β + γ = 1 (Ikhouane and Rodellar, 2007, normalised);
- a bank of Duhem states after Coleman and Hodgdon (1986), dz = α|dv| (f(v) - z), each with a power of v
  as f: their loops drift as they are repeated, which the loops of plays never do.
"""

import math
from typing import Any

import numba
import numpy as np
from numba.extending import register_jitable

from torchpi.operators.generalised_play import clamp_play

_clamp_play: Any = numba.njit(clamp_play)
TOGETHER = 128
"""Samples per block when many sums are written, so that a block stays in the cache."""
DUHEM_POWERS = tuple(range(1, 9))
"""Power of v that each state of a bank has as f, counting from 1: any smooth f is nearly a sum of these."""


def bend(v: float, asymmetry_per_v: float) -> float:
    """Return a v²: the rising envelope is above v by it, the falling one below. Also for tensors."""
    return asymmetry_per_v * v * v


def gain_inside(v: float, rate: float, incongruence_per_v: float, weight_s_per_v: float) -> float:
    """Return (1 + κ v)(1 + k v̇), the factor on the states that have memory. Also for tensors."""
    return (1.0 + incongruence_per_v * v) * (1.0 + weight_s_per_v * rate)


def straight_gain(gain: float, straight_share: float) -> float:
    """Return 1 - q (g - 1), the factor on v itself, which keeps the loop's chord. Also for tensors."""
    return 1.0 - straight_share * (gain - 1.0)


def threshold_widening(rate: float, threshold_s_per_v: float) -> float:
    """Return 1 + β |v̇|, the factor on the thresholds. Also for tensors."""
    return 1.0 + threshold_s_per_v * abs(rate)


def kept_after(period_s: float, time_constant_s: float) -> float:
    """Return e^{-T/τ}, the share of a distance that is kept over a period; 0 without a time constant."""
    return math.exp(-period_s / time_constant_s) if time_constant_s > 0.0 else 0.0


def towards(bound: float, h: float, kept: float) -> float:
    """Return p + e^{-T/τ} (h - p), where a play relaxes to; `kept` is the exponential."""
    return bound + kept * (h - bound)


def loop_widening(rate: float, loop_per_e: float, reference_rate_v_s: float) -> float:
    """Return γ ln(1 + |v̇| / v̇₀), the relative growth of a state's distance from c v, the loop's chord."""
    return loop_per_e * math.log1p(abs(rate) / reference_rate_v_s)


def bouc_wen(z: float, dv: float, sigma: float, beta: float, n: float) -> float:
    """Return z after v moves linearly by dv, by the midpoint rule in steps of at most σ/20. A move of many σ
    ends as soon as a step no longer changes z, which is then ±1 but for rounding."""
    pieces = int(abs(dv) / sigma * 20.0) + 1
    move = dv / pieces
    piece, changes = 0, True
    while changes and piece < pieces:
        at = z
        for part in (0.5, 1.0):
            sign = 1.0 if at * move >= 0.0 else -1.0
            at = z + part * move / sigma * (1.0 - abs(at) ** n * (1.0 - beta + beta * sign))
        changes = at != z
        z = at
        piece += 1
    return z


def piece_of(x: float, low: float, piece: float, pieces: int) -> int:
    """Return the index of the piece that contains x, of `pieces` pieces of length `piece` from `low` on; the
    first and the last extend beyond. TorchScript compiles it as well."""
    if pieces == 1:
        return 0
    place = (x - low) / piece
    if place >= pieces:
        return pieces - 1
    if place > 0.0:
        return int(place)
    return 0


def offsets_of(slopes: Any, low: float, piece: float) -> list[Any]:
    """Return the offsets of a piecewise linear function, slope x + offset, that is 0 at 0, from its slopes,
    (pieces, …), as tensors or arrays."""
    offsets, left = [], 0.0
    for k in range(len(slopes)):
        offsets.append(left - slopes[k] * (low + k * piece))
        left = left + slopes[k] * piece
    at_rest = piece_of(0.0, low, piece, len(slopes))
    return [offset - offsets[at_rest] for offset in offsets]


def duhem(z: float, v: float, before: float, alpha: float, power: int) -> float:
    """Return z after a linear move from `before` to v, z e^{-A} + ∫ e^{-(A - s)} f(v(s)) ds, A = α|dv|."""
    whole = alpha * abs(v - before)
    if whole < 1e-30:  # a decaying voltage: the pieces may be too short to be represented
        return z
    pieces, gap, kept, first, second = duhem_pieces(v, before, whole)
    move = (v - before) / pieces
    for piece in range(pieces):
        early, late = duhem_points(before, move, piece, gap)
        f_early, f_late = 1.0, 1.0
        for _ in range(power):
            f_early, f_late = f_early * early, f_late * late
        z = kept * z + first * f_early + second * f_late
    return z


@register_jitable
def duhem_points(before: float, move: float, piece: int, gap: float) -> tuple[float, float]:
    """Return the voltages at the two Gauss points of a piece, if each piece moves by `move`."""
    return before + move * (piece + 0.5 * (1.0 - gap)), before + move * (piece + 0.5 * (1.0 + gap))


@register_jitable
def duhem_pieces(v: float, before: float, whole: float) -> tuple[int, float, float, float, float]:
    """Return how a move of A = `whole`, at least 1e-30, is integrated: the number of pieces, the distance of
    the two Gauss points in each, the factor on z, and the weights of f at both points, exact for a linear f.

    There are up to 64 pieces, each shorter than a twenty-fifth of the memory and, because f is curved,
    than an eighth of the voltages.
    """
    pieces = int(min(whole * 25.0 + 8.0 * abs(v - before) / (abs(v) + abs(before)), 63.0)) + 1
    part, gap = whole / pieces, math.sqrt(3.0) / 3.0
    share = -math.expm1(-part)
    second = (1.0 - share / part - 0.5 * (1.0 - gap) * share) / gap
    return pieces, gap, math.exp(-part), share - second, second


_towards: Any = numba.njit(towards)
_bouc_wen: Any = numba.njit(bouc_wen)
_piece_of: Any = numba.njit(piece_of, error_model="numpy")


@numba.njit(cache=True, error_model="numpy")
def play_states(
    chord: np.ndarray, up: np.ndarray, down: np.ndarray, widening: np.ndarray, gain: np.ndarray,
    straight: np.ndarray, loop: np.ndarray, r: np.ndarray, kept: float, h: np.ndarray, x: np.ndarray,
) -> None:  # fmt: skip
    """Write the states h of max{up - r w, min{down + r w, h}} into `x`, (time, plays).

    `gain` multiplies the states with memory, `straight` v itself, and `loop` widens all about the chord; all
    are (time,). Of its distance to that position, a play with memory keeps the share `kept` in a sample.
    `h`, (plays,), holds the initial states and receives the final ones.
    """
    for t in range(len(up)):
        _move(up[t], down[t], widening[t], r, kept, h)
        for i in range(len(r)):
            x[t, i] = _inner(h[i], gain[t] if r[i] > 0.0 else straight[t], chord[t], loop[t])


@numba.njit(cache=True, error_model="numpy")
def sums_of_plays(
    chord: np.ndarray, up: np.ndarray, down: np.ndarray, widening: np.ndarray, gain: np.ndarray,
    straight: np.ndarray, loop: np.ndarray, r: np.ndarray, kept: float, low: float, piece: float,
    slopes: np.ndarray, offsets: np.ndarray, h: np.ndarray, y: np.ndarray,
) -> None:  # fmt: skip
    """Write Σ_i F_is(x_i) into `y`, (time, sums); the slopes and offsets of F are (pieces, plays, sums).

    `h`, (plays,), holds the initial states of the plays and receives the final ones.
    """
    pieces, _, sums = slopes.shape
    for t in range(len(up)):
        _move(up[t], down[t], widening[t], r, kept, h)
        total = y[t]
        total[:] = 0.0
        for i in range(len(r)):
            x = _inner(h[i], gain[t] if r[i] > 0.0 else straight[t], chord[t], loop[t])
            k = _piece_of(x, low, piece, pieces)
            slope, offset = slopes[k, i], offsets[k, i]
            for s in range(sums):
                total[s] += offset[s] + slope[s] * x


@numba.njit(cache=True, fastmath={"reassoc"}, error_model="numpy")
def play_sum(
    chord: np.ndarray, up: np.ndarray, down: np.ndarray, widening: np.ndarray, gain: np.ndarray,
    straight: np.ndarray, loop: np.ndarray, r: np.ndarray, kept: float, low: float, piece: float,
    slopes: np.ndarray, offsets: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Return Σ_i F_i(x_i), (time,), without storing the rows; slopes and offsets are (pieces, plays).

    Where F is linear, this is seven times as fast as one play after another: the loop over plays runs in
    vector registers and sums in any order.
    """
    y, h, pieces = np.empty(len(up)), np.zeros(len(r)), len(slopes)
    for t in range(len(up)):
        _move(up[t], down[t], widening[t], r, kept, h)
        grown, line, total = gain[t], straight[t], 0.0
        if pieces == 1:
            for i in range(len(r)):
                total += slopes[0, i] * _inner(h[i], grown if r[i] > 0.0 else line, chord[t], loop[t])
        else:
            for i in range(len(r)):
                x = _inner(h[i], grown if r[i] > 0.0 else line, chord[t], loop[t])
                k = _piece_of(x, low, piece, pieces)
                total += offsets[k, i] + slopes[k, i] * x
        y[t] = total
    return y


@numba.njit(cache=True, error_model="numpy")
def sums_of_plain_plays(
    v: np.ndarray,
    r: np.ndarray,
    low: float,
    piece: float,
    slopes: np.ndarray,
    offsets: np.ndarray,
    y: np.ndarray,
) -> None:
    """Write Σ_i F_is(h_i) into `y`, (sums, time), for plays max{v - r, min{v + r, h}} that start from 0.

    The plays that move with v are those with the smallest thresholds, and they move in parallel: their sum is
    linear in v until one of them enters its next piece. The cost of a step depends on how many plays start
    to move or change piece, not on how many there are. Each inner loop takes views of one row, since loops
    over indexed arrays are compiled without vector instructions and take several times as long.

    Args:
        v: (time,).
        r: (plays,), ascending.
        low: Start of the first piece of F.
        piece: Length of each piece.
        slopes: (pieces, plays, sums).
        offsets: Offsets of F, of the same shape.
        y: Output, written.
    """
    pieces, plays, sums = slopes.shape
    h, at = np.zeros(plays), np.empty(plays, np.int64)
    slope, offset, block = np.zeros(sums), np.zeros(sums), np.empty((TOGETHER, sums))
    for i in range(plays):
        at[i] = _piece_of(0.0, low, piece, pieces)
        for s in range(sums):
            offset[s] += offsets[at[i], i, s]
    moving, sign, before = 0, 1.0, 0.0
    for first in range(0, len(v), TOGETHER):
        stop = min(first + TOGETHER, len(v))
        for t in range(first, stop):
            now = v[t]
            if (now - before) * sign < 0.0:
                for i in range(moving):
                    h[i] = before - sign * r[i]
                for s in range(sums):
                    offset[s] += slope[s] * before
                    slope[s] = 0.0
                moving, sign = 0, -sign
            while moving < plays and sign * (now - h[moving]) > r[moving]:
                left, its_slope = h[moving] + sign * r[moving], slopes[at[moving], moving]
                for s in range(sums):
                    slope[s] += its_slope[s]
                    offset[s] -= its_slope[s] * left
                moving += 1
            if pieces > 1:
                for i in range(moving):
                    k, old = _piece_of(now - sign * r[i], low, piece, pieces), at[i]
                    if k != old:
                        slope_in, offset_in = slopes[k, i], offsets[k, i]
                        slope_out, offset_out = slopes[old, i], offsets[old, i]
                        for s in range(sums):
                            more = slope_in[s] - slope_out[s]
                            slope[s] += more
                            offset[s] += offset_in[s] - offset_out[s] - more * sign * r[i]
                        at[i] = k
            for s in range(sums):
                block[t - first, s] = offset[s] + slope[s] * now
            before = now
        for s in range(sums):
            for t in range(first, stop):
                y[s, t] = block[t - first, s]


@numba.njit(cache=True, inline="always")
def _move(rising: float, falling: float, width: float, r: np.ndarray, kept: float, h: np.ndarray) -> None:
    if kept == 0.0:
        for i in range(len(r)):
            h[i] = _clamp_play(rising - r[i] * width, falling + r[i] * width, h[i])
        return
    for i in range(len(r)):
        bound = _clamp_play(rising - r[i] * width, falling + r[i] * width, h[i])
        h[i] = _towards(bound, h[i], kept if r[i] > 0.0 else 0.0)


@numba.njit(cache=True, inline="always")
def _inner(h: float, gain: float, chord: float, loop: float) -> float:
    state = h * gain
    return state + (state - chord) * loop


@numba.njit(cache=True)
def bouc_wen_row(v: np.ndarray, sigma: float, beta: float, n: float, start: float) -> np.ndarray:
    """Return z, (time,), of a Bouc–Wen state that has the value `start` at v = 0."""
    row = np.empty(len(v))
    z, before = start, 0.0
    for t in range(len(v)):
        z = _bouc_wen(z, v[t] - before, sigma, beta, n)
        row[t] = z
        before = v[t]
    return row


@numba.njit(cache=True)
def duhem_rows(v: np.ndarray, alpha: float) -> np.ndarray:
    """Return the Duhem states of all powers, (powers, time), which are 0 at v = 0.

    They move as `duhem` moves each, in a quarter of the time: they share the pieces and the powers.
    """
    rows, z, before = np.empty((len(DUHEM_POWERS), len(v))), np.zeros(len(DUHEM_POWERS)), 0.0
    for t in range(len(v)):
        whole = alpha * abs(v[t] - before)
        if whole >= 1e-30:
            pieces, gap, kept, first, second = duhem_pieces(v[t], before, whole)
            move = (v[t] - before) / pieces
            for piece in range(pieces):
                early, late = duhem_points(before, move, piece, gap)
                f_early, f_late = 1.0, 1.0
                for k in range(len(DUHEM_POWERS)):
                    f_early, f_late = f_early * early, f_late * late
                    z[k] = kept * z[k] + first * f_early + second * f_late
        rows[:, t] = z
        before = v[t]
    return rows


@numba.njit(cache=True)
def smooth(x: np.ndarray, decay: float) -> np.ndarray:
    """Return x, (time,), through a first-order low-pass that starts from rest."""
    y = np.empty(len(x))
    state = 0.0
    for t in range(len(x)):
        state = decay * state + (1.0 - decay) * x[t]
        y[t] = state
    return y
