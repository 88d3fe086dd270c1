"""Elementary hysteresis states as rows, (states, time): what a search over nominal hysteresis needs fast.

Three families, each linear in its weights once the rows stand:

- generalised plays (Prandtl–Ishlinskii, and Preisach in play form through output functions),
  h = max{v_up - r, min{v_down + r, h}};
- Bouc–Wen, dz/dv = 1/σ [1 - |z|ⁿ (γ + β sgn(z dv))], β + γ = 1 (Ikhouane and Rodellar, 2007, normalised);
- a bank of Duhem states after Coleman and Hodgdon (1986), dz = α|dv| (f(v) - z), a power of v each for f:
  loops that move as they are repeated, which plays never do.
"""

import math
from typing import Any

import numba
import numpy as np
from numba.extending import register_jitable

from torchpi.operators.generalised_play import clamp_play

_clamp_play: Any = numba.njit(clamp_play)
TOGETHER = 128
"""Samples of many sums that are written at a time: they stay in the cache."""
DUHEM_POWERS = tuple(range(1, 9))
"""The power of v of each state of a bank: any smooth f is all but a sum of these."""


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
    """z after a straight move from `before` to v, z e^{-A} + ∫ e^{-(A - s)} f(v(s)) ds with A = α|dv|."""
    whole = alpha * abs(v - before)
    if whole == 0.0:
        return z
    pieces, gap, kept, first, second = duhem_pieces(v, before, whole)
    move = (v - before) / pieces
    for piece in range(pieces):
        early = before + move * (piece + 0.5 * (1.0 - gap))
        late = before + move * (piece + 0.5 * (1.0 + gap))
        f_early, f_late = 1.0, 1.0
        for _ in range(power):
            f_early, f_late = f_early * early, f_late * late
        z = kept * z + first * f_early + second * f_late
    return z


@register_jitable
def duhem_pieces(v: float, before: float, whole: float) -> tuple[int, float, float, float, float]:
    """How a move of A = `whole`, which is not 0, is integrated: in how many pieces, how far apart Gauss's two
    points are in each, what is kept of z, and the weights of f at both, exact for a straight f.

    The pieces are up to 64, shorter than a twenty-fifth of the memory, and than an eighth of the voltages,
    where f is curved.
    """
    pieces = int(min(whole * 25.0 + 8.0 * abs(v - before) / (abs(v) + abs(before)), 63.0)) + 1
    part, gap = whole / pieces, math.sqrt(3.0) / 3.0
    share = -math.expm1(-part)
    second = (1.0 - share / part - 0.5 * (1.0 - gap) * share) / gap
    return pieces, gap, math.exp(-part), share - second, second


_bouc_wen: Any = numba.njit(bouc_wen)
_duhem: Any = numba.njit(duhem)


@numba.njit(cache=True, error_model="numpy")
def play_states(
    chord: np.ndarray, up: np.ndarray, down: np.ndarray, r: np.ndarray, widening: np.ndarray,
    gain: np.ndarray, straight: np.ndarray, loop: np.ndarray, scale: float, h: np.ndarray, x: np.ndarray,
) -> None:  # fmt: skip
    """Into `x`, (time, degree, plays): the states h of max{up - r w, min{down + r w, h}}, h (h / scale)^p.

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
        for p in range(1, x.shape[1]):
            power, below = x[t, p], x[t, p - 1]
            for i in range(len(r)):
                power[i] = below[i] * (first[i] / scale)


@numba.njit(cache=True, fastmath={"reassoc"}, error_model="numpy")
def play_sum(
    chord: np.ndarray, up: np.ndarray, down: np.ndarray, r: np.ndarray, widening: np.ndarray,
    gain: np.ndarray, straight: np.ndarray, loop: np.ndarray, scale: float, weights: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """(time,): Σ_p Σ_i w_pi h_i (h_i / scale)^p without the rows; weights are (degree, plays).

    Seven times as fast as one play after another: the loop over plays runs in vector registers, and sums in
    any order.
    """
    y, h, degree = np.empty(len(up)), np.zeros(len(r)), weights.shape[0]
    x, term, per_scale = np.empty(len(r)), np.empty(len(r)), 1.0 / scale
    for t in range(len(up)):
        rising, falling, width = up[t], down[t], widening[t]
        for i in range(len(r)):
            h[i] = _clamp_play(rising - r[i] * width, falling + r[i] * width, h[i])
        grown, kept, looped, middle, total = gain[t], straight[t], loop[t], chord[t], 0.0
        for i in range(len(r)):
            state = h[i] * (grown if r[i] > 0.0 else kept)
            x[i] = state + (state - middle) * looped
            term[i] = weights[degree - 1, i]
        for p in range(degree - 2, -1, -1):
            for i in range(len(r)):
                term[i] = term[i] * (x[i] * per_scale) + weights[p, i]
        for i in range(len(r)):
            total += term[i] * x[i]
        y[t] = total
    return y


@numba.njit(cache=True, error_model="numpy")
def sums_of_plain_plays(
    v: np.ndarray, r: np.ndarray, scale: float, weights: np.ndarray, y: np.ndarray
) -> None:
    """Into `y`, (sums, time): Σ_p Σ_i w_pis h_i (h_i / scale)^p of plays max{v - r, min{v + r, h}} from 0.

    The plays that move with v are those of the smallest thresholds, and they move alike: their share is a
    polynomial in v, whose coefficients are sums over all smaller thresholds, tabulated beforehand. A step
    costs as much as the plays that it newly moves, not as much as there are plays.

    Args:
        v: (time,).
        r: (plays,), ascending.
        scale: Of the powers.
        weights: (degree, plays, sums).
        y: What is written.
    """
    degree, plays, sums = weights.shape
    u, thresholds = v / scale, r / scale
    tables = np.zeros((2, plays + 1, degree + 1, sums))
    for which in range(2):
        for i in range(plays):
            shift = -thresholds[i] if which == 0 else thresholds[i]
            for p in range(degree):
                # (u + shift)^(p + 1) by the binomial theorem, the highest power of u first.
                factor = scale
                for j in range(p + 1, -1, -1):
                    for s in range(sums):
                        tables[which, i + 1, j, s] += weights[p, i, s] * factor
                    factor *= shift * j / (p + 2 - j)
            for j in range(degree + 1):
                for s in range(sums):
                    tables[which, i + 1, j, s] += tables[which, i, j, s]
    h, still = np.zeros(plays), np.zeros(sums)
    block, total = np.empty((TOGETHER, sums)), np.empty(sums)
    moving, sign, before = 0, 1.0, 0.0
    for first in range(0, len(u), TOGETHER):
        stop = min(first + TOGETHER, len(u))
        for t in range(first, stop):
            now = u[t]
            if (now - before) * sign < 0.0:
                for i in range(moving):
                    h[i] = before - sign * thresholds[i]
                _polynomials(before, tables[0 if sign > 0.0 else 1, moving], total)
                for s in range(sums):
                    still[s] += total[s]
                moving, sign = 0, -sign
            while moving < plays and sign * (now - h[moving]) > thresholds[moving]:
                state, power = h[moving], scale
                for p in range(degree):
                    power *= state
                    for s in range(sums):
                        still[s] -= weights[p, moving, s] * power
                moving += 1
            at = block[t - first]
            _polynomials(now, tables[0 if sign > 0.0 else 1, moving], at)
            for s in range(sums):
                at[s] += still[s]
            before = now
        for s in range(sums):
            for t in range(first, stop):
                y[s, t] = block[t - first, s]


@numba.njit(cache=True, inline="always")
def _polynomials(x: float, coefficients: np.ndarray, y: np.ndarray) -> None:
    """Into y, (sums,): polynomials in x, of coefficients (powers, sums), the lowest power first."""
    highest = len(coefficients) - 1
    for s in range(len(y)):
        y[s] = coefficients[highest, s]
    for j in range(highest - 1, -1, -1):
        for s in range(len(y)):
            y[s] = y[s] * x + coefficients[j, s]


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
