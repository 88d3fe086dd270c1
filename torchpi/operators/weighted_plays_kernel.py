"""The compiled form of `weighted_plays`: polynomial, plays and weights over whole records, and the adjoint.

The kernels work on one tile and one play at a time, so that no array has the size (time, plays). Only the
states before each tile are kept, 1/STEPS of it, from which backward recomputes the states in between.
"""

from typing import NamedTuple

import numpy as np

from torchpi.operators.adjoint_tile import (
    GAMMA,
    GH,
    GS,
    WAITING,
    H,
    S,
    advance_dots,
    land,
    land_linear,
    work_size,
)
from torchpi.operators.compiled import in_threads, njit
from torchpi.operators.folded import (
    LANES,
    STEPS,
    TILE,
    accumulate,
    advance,
    advance_linear_sum,
    advance_sum,
    chain,
    compose,
    dot,
    expect_pushes,
    extent,
    fold,
    fold_shape,
    hand_over,
    note_latest,
    raise_powers,
    threshold_gradient,
    unfold,
)
from torchpi.operators.polynomial import horner
from torchpi.operators.rate_weights import squash

_horner = njit(horner)
_squash = njit(squash)


class Parameters(NamedTuple):
    """Parameters of eq. 8, all of one floating type."""

    c: np.ndarray  # (degree,)
    r: np.ndarray  # (plays,)
    theta: np.ndarray  # (plays, functions of the rate)
    knots: np.ndarray  # (functions - 2, 2): slope and shift of each squashed function
    psi: np.ndarray  # (plays, degree of the output functions - 1)
    offset: np.ndarray  # (1,)
    scales: np.ndarray  # (2,): of the rate, of the states


def forward(
    x: np.ndarray,
    rate: np.ndarray,
    h0: np.ndarray,
    p: Parameters,
    u: np.ndarray,
    final: np.ndarray,
    folded: np.ndarray,
    checkpoints: np.ndarray,
) -> None:
    """Fill the last four arguments; backward needs `folded` and `checkpoints`, of the `saved_shapes`."""
    groups, length = fold_shape(x.shape[1])
    low, high, starts = np.empty((3, len(x), groups, len(p.r), LANES), x.dtype)
    in_threads(_prepare, len(x) * groups, x, length, p, folded, low, high)
    chain(low, high, h0, starts, final)
    in_threads(_forward, len(x) * groups, rate, length, p, starts, folded, u, checkpoints)


def saved_shapes(batch: int, samples: int, plays: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    groups, length = fold_shape(samples)
    return (batch, groups, length * LANES), (batch, groups, -(-length // STEPS), plays, LANES)


@njit
def _prepare(
    first: int,
    last: int,
    x: np.ndarray,
    length: int,
    p: Parameters,
    folded: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> None:
    """Compute S(x), folded, and the clamp that every stretch applies to the states."""
    tile = np.empty(TILE, x.dtype)
    lows, highs = np.empty(TILE + LANES, x.dtype), np.empty(TILE + LANES, x.dtype)
    least, most = np.empty(LANES, x.dtype), np.empty(LANES, x.dtype)
    for task in range(first, last):
        row, group = divmod(task, low.shape[1])
        for begin in range(0, length, STEPS):
            end = min(begin + STEPS, length)
            s = folded[row, group, begin * LANES : end * LANES]
            fold(x[row], group, begin, end, length, tile)
            s[:] = 0
            for j in range(len(p.c) - 1, -1, -1):
                c = p.c[j]
                for q in range(len(s)):
                    s[q] = _horner(s[q], c, tile[q])
        extent(folded[row, group], least, most)
        for i in range(len(p.r)):
            compose(
                folded[row, group], p.r[i], least, most, low[row, group, i], high[row, group, i], lows, highs
            )


@njit
def _forward(
    first: int, last: int, rate: np.ndarray, length: int, p: Parameters, starts: np.ndarray,
    folded: np.ndarray, u: np.ndarray, checkpoints: np.ndarray,
) -> None:  # fmt: skip
    phi = np.ones((p.theta.shape[1], TILE), u.dtype)
    h = np.empty(TILE + LANES, u.dtype)
    w, own, total = np.empty(TILE, u.dtype), np.empty(TILE, u.dtype), np.empty(TILE, u.dtype)
    for task in range(first, last):
        row, group = divmod(task, starts.shape[1])
        states = checkpoints[row, group]
        states[0] = starts[row, group]
        for tile in range(len(states)):
            begin, end = tile * STEPS, min(tile * STEPS + STEPS, length)
            s = folded[row, group, begin * LANES : end * LANES]
            count = len(s)
            _basis(rate[row], group, begin, end, length, p, phi)
            total[:] = 0
            for i in range(len(p.r)):
                h[:LANES] = states[tile, i]
                if p.psi.shape[1] > 0:
                    advance(s, p.r[i], h, count)
                    _combine(p.theta[i], phi, count, w)
                    _add_own_weight(p, i, h, count, own, w)
                    for q in range(count):
                        total[q] += w[q] * h[q + LANES]
                elif len(phi) == 2:
                    advance_linear_sum(s, p.r[i], h, p.theta[i, 0], p.theta[i, 1], phi[1], count, total)
                else:
                    _combine(p.theta[i], phi, count, w)
                    advance_sum(s, p.r[i], h, w, count, total)
                if end < length:
                    states[tile + 1, i] = h[count : count + LANES]
            offset = p.offset[0]
            for q in range(count):
                total[q] += offset
            unfold(total, group, begin, end, length, u[row])


@njit
def _basis(
    rate: np.ndarray, group: int, begin: int, end: int, length: int, p: Parameters, phi: np.ndarray
) -> None:
    """Compute φ_1, φ_2, … of eq. 7 and its extensions over a tile; φ_0 is 1."""
    count = (end - begin) * LANES
    if len(phi) == 1:
        return
    z = phi[1]
    fold(rate, group, begin, end, length, z)
    scale = p.scales[0]
    for q in range(count):
        z[q] = z[q] / scale
    for m in range(2, len(phi)):
        out, slope, shift = phi[m], p.knots[m - 2, 0], p.knots[m - 2, 1]
        for q in range(count):
            out[q] = _squash(slope * z[q] + shift)


@njit
def _add_own_weight(p: Parameters, i: int, h: np.ndarray, count: int, own: np.ndarray, w: np.ndarray) -> None:
    scale = p.scales[1]
    own[:count] = 0
    for j in range(p.psi.shape[1] - 1, -1, -1):
        psi = p.psi[i, j]
        for q in range(count):
            own[q] = _horner(own[q], psi, h[q + LANES] / scale)
    for q in range(count):
        w[q] += own[q]


@njit
def _combine(theta: np.ndarray, phi: np.ndarray, count: int, out: np.ndarray) -> None:
    """Compute θ_0 φ_0 + θ_1 φ_1 + …, summed left to right."""
    first, theta_0 = phi[0], theta[0]
    if len(phi) == 1:
        for q in range(count):
            out[q] = theta_0 * first[q]
        return
    second, theta_1 = phi[1], theta[1]
    for q in range(count):
        out[q] = theta_0 * first[q] + theta_1 * second[q]
    for m in range(2, len(phi)):
        function, theta_m = phi[m], theta[m]
        for q in range(count):
            out[q] += theta_m * function[q]


class Gradients(NamedTuple):
    """Gradients with respect to each of the parameters."""

    c: np.ndarray  # (degree,)
    r: np.ndarray  # (plays,)
    theta: np.ndarray  # (plays, functions)
    knots: np.ndarray  # (functions - 2, 2)
    psi: np.ndarray  # (plays, degree - 1)
    offset: np.ndarray  # (1,)


def backward(
    x: np.ndarray, rate: np.ndarray, p: Parameters, folded: np.ndarray, checkpoints: np.ndarray,
    gu: np.ndarray, gh: np.ndarray, with_rate: bool, with_r: bool, gx: np.ndarray, grate: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Fill `gx` and, if `with_rate`, `grate`; return the gradients of c, r, θ, the knots, ψ and the offset,
    one after the other.

    `gh` (batch, plays) is the gradient of the last states on entry and that of the first on return.
    """
    batch, groups, _, plays, _ = checkpoints.shape
    length, degree = folded.shape[2] // LANES, len(p.c)
    left, latest = np.zeros((2, batch, groups, plays, LANES), x.dtype)
    # One row per group, so that the final sum always has the same order.
    sums = np.zeros((batch, groups, sum(part.size for part in p[:6])), x.dtype)
    in_threads(
        _backward, batch * groups, rate, length, p, folded, checkpoints, gu, with_rate, with_r,
        gx, grate, left, latest, sums,
    )  # fmt: skip
    hand_over(left, latest, length, gx, sums[:, 0, degree : degree + plays], gh)
    in_threads(_through_polynomial, batch * groups, x, length, p.c, gx, sums)
    gradients: np.ndarray = sums.sum((0, 1))
    return gradients


@njit
def _gradients(sums: np.ndarray, p: Parameters) -> Gradients:
    """Return views of the gradients in the sums of one group."""
    r = len(p.c)
    theta = r + p.r.size
    knots = theta + p.theta.size
    psi = knots + p.knots.size
    offset = psi + p.psi.size
    return Gradients(
        sums[:r],
        sums[r:theta],
        sums[theta:knots].reshape(p.theta.shape),
        sums[knots:psi].reshape(p.knots.shape),
        sums[psi:offset].reshape(p.psi.shape),
        sums[offset:],
    )


@njit
def _backward(
    first: int, last: int, rate: np.ndarray, length: int, p: Parameters, folded: np.ndarray,
    checkpoints: np.ndarray, gu: np.ndarray, with_rate: bool, with_r: bool,
    gx: np.ndarray, grate: np.ndarray, left: np.ndarray, latest: np.ndarray, sums: np.ndarray,
) -> None:  # fmt: skip
    plays, functions, degree = len(p.r), p.theta.shape[1], p.psi.shape[1]
    # γ = φ g and v = Σ_i θ_i h_i: with them the gradients of w_i h_i = Σ_m θ_im φ_m h_i are plain sums.
    phi, v = np.ones((functions, TILE), gu.dtype), np.empty((functions, TILE), gu.dtype)
    work, power = np.empty(work_size(functions), gu.dtype), np.empty(TILE, gu.dtype)
    s, gs, h, gh, waiting = work[S:], work[GS:], work[H:], work[GH:], work[WAITING:]
    gamma, after = work[GAMMA:].reshape(functions, TILE), h[LANES:]
    least, most = np.empty(LANES, gu.dtype), np.empty(LANES, gu.dtype)
    for task in range(first, last):
        row, group = divmod(task, left.shape[1])
        states, waits, pushes = checkpoints[row, group], left[row, group], latest[row, group]
        parts = _gradients(sums[row, group], p)
        extent(folded[row, group], least, most)
        for i in range(plays):
            expect_pushes(p.r[i], states[0, i], least, most, pushes[i])
        for tile in range(len(states) - 1, -1, -1):
            begin, end = tile * STEPS, min(tile * STEPS + STEPS, length)
            count = (end - begin) * LANES
            s[:count] = folded[row, group, begin * LANES : end * LANES]
            _basis(rate[row], group, begin, end, length, p, phi)
            g = gamma[0]
            fold(gu[row], group, begin, end, length, g)
            _clear_padding(g, group, begin, end, length, gu.shape[1])
            for m in range(1, functions):
                function, product = phi[m], gamma[m]
                for q in range(count):
                    product[q] = function[q] * g[q]
            parts.offset[0] += dot(g, phi[0], count)
            gs[:count] = 0
            if with_rate:
                v[:] = 0
            for i in range(plays):
                h[:LANES] = states[tile, i]
                if functions == 2:
                    constant, linear = advance_dots(work, p.r[i], count)
                    parts.theta[i, 0] += constant
                    parts.theta[i, 1] += linear
                else:
                    advance(s, p.r[i], h, count)
                    for m in range(functions):
                        parts.theta[i, m] += dot(gamma[m], after, count)
                if with_rate:
                    for m in range(1, functions):
                        accumulate(p.theta[i, m], after, count, v[m])
                waiting[count : count + LANES] = waits[i]
                if functions == 2 and degree == 0 and not with_r:
                    land_linear(work, p.r[i], p.theta[i, 0], p.theta[i, 1], count)
                else:
                    _combine(p.theta[i], gamma, count, gh)
                    if degree > 0:
                        _own_gradients(p, i, g, after, count, power, gh, parts.psi[i])
                    land(work, p.r[i], count)
                waits[i] = waiting[:LANES]
                if with_r:
                    parts.r[i] += threshold_gradient(gh, s, h, waiting, count)
                note_latest(s, p.r[i], h, count, begin, pushes[i])
            unfold(gs, group, begin, end, length, gx[row])
            if with_rate and functions > 1:
                _rate_gradient(p, phi, v, g, count, parts.knots)
                unfold(v[1], group, begin, end, length, grate[row])


@njit
def _clear_padding(g: np.ndarray, group: int, begin: int, end: int, length: int, samples: int) -> None:
    """Set the gradient of steps beyond the record to 0."""
    for lane in range(LANES):
        inside = max(samples - (group * LANES + lane) * length, begin)
        for step in range(inside, end):
            g[(step - begin) * LANES + lane] = 0


@njit
def _own_gradients(
    p: Parameters,
    i: int,
    g: np.ndarray,
    h: np.ndarray,
    count: int,
    power: np.ndarray,
    gh: np.ndarray,
    gpsi: np.ndarray,
) -> None:
    """Add the gradients of ψ_q z^q h, z = h / scale: z^q h for ψ_q and (q + 1) ψ_q z^q for h."""
    scale = p.scales[1]
    power[:count] = g[:count]
    for j in range(len(gpsi)):
        slope = p.psi[i, j] * (j + 2)
        for q in range(count):
            power[q] *= h[q] / scale
            gh[q] += slope * power[q]
        gpsi[j] += dot(power, h, count)


@njit
def _rate_gradient(
    p: Parameters, phi: np.ndarray, v: np.ndarray, g: np.ndarray, count: int, gknots: np.ndarray
) -> None:
    """Add the gradients of slopes and shifts of the squashed functions; leave that of ẏ in `v[1]`."""
    z, gz = phi[1], v[1]
    for q in range(count):
        gz[q] *= g[q]
    for m in range(2, len(phi)):
        inner, outer = v[m], phi[m]
        slope = p.knots[m - 2, 0]
        for q in range(count):
            # squash' = 1 / (1 + |.|)² = (1 - |squash|)²
            rest = 1 - abs(outer[q])
            inner[q] *= g[q] * rest * rest
            gz[q] += slope * inner[q]
        gknots[m - 2, 0] += dot(inner, z, count)
        gknots[m - 2, 1] += dot(inner, phi[0], count)
    scale = p.scales[0]
    for q in range(count):
        gz[q] = gz[q] / scale


@njit
def _through_polynomial(
    first: int, last: int, x: np.ndarray, length: int, c: np.ndarray, gx: np.ndarray, sums: np.ndarray
) -> None:
    """Turn the gradient of S(x) into that of x, in place, and add that of c: the adjoint of eq. 4."""
    power = np.empty(TILE, x.dtype)
    nothing = x.dtype.type(0)
    for task in range(first, last):
        row, group = divmod(task, sums.shape[1])
        stop = min((group + 1) * LANES * length, x.shape[1])
        for begin in range(group * LANES * length, stop, TILE):
            count = min(TILE, stop - begin)
            a, g = x[row, begin : begin + count], gx[row, begin : begin + count]
            power[:count] = g
            g[:] = 0
            for j in range(0, len(c), 2):
                another = j + 1 < len(c)
                next_factor = c[j + 1] * (j + 2) if another else nothing
                one, two = raise_powers(power, a, c[j] * (j + 1), next_factor, g)
                sums[row, group, j] += one
                if another:
                    sums[row, group, j + 1] += two
