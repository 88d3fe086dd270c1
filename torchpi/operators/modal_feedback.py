"""Modes with hysteretic feedback, m inputs and p outputs, sampled: the compiled step and its exact tangents.

    v_i  = u_i + Σ_r h_ir k_ir                    k_ir, what plays and amplifiers add to the inputs, given
    z_n  = Σ_m a_nm · x_m + Σ_i f_ni v_i          what the nonlinear element n senses of modes and inputs
    w_n  = Σ_j θ_nj φ_nj(z_n)                     its force
    x_m⁺ = Λ_m x_m + Σ_i b_mi v_i + Σ_n e_mn w_n  modes, pairs of real states, Λ = [[α, -β], [β, α]]
    y_o  = Σ_m c_om · x_m + Σ_i d_oi v_i

The functions φ of an element, in this order: dead zones, max(z - r, 0) for r ≥ 0 and min(z - r, 0) for r < 0;
plays less their input, P_r[z] - z; z √s_τ, with s_τ the mean of |z| over a time τ, a stiffness that follows
the amplitude slowly; and z k_ir for its own input (i = n mod m), one that follows the voltage.
Plays and dead zones in superposition: Kuhnen, European J. Control 9(4), 2003; the linear part with feedback
around it: Paduart et al., Automatica 46(4), 2010.
"""

from typing import NamedTuple

import numpy as np

from torchpi.operators.compiled import njit
from torchpi.operators.play_equation import play

SMALLEST_MEAN = 1e-4
"""Added to the mean of |z| under the root, whose slope has no bound at 0."""
DIVERGED = 1e6
_play = njit(play)


class Shapes(NamedTuple):
    """How many there are of each."""

    inputs: int
    outputs: int
    modes: int
    elements: int
    functions: int
    input_plays: int


def parameter_shapes(shapes: Shapes) -> dict[str, tuple[int, ...]]:
    """The parameters by name, in the order in which the kernel and its tangents have them."""
    m, p, modes, n, functions, plays = shapes
    return {
        "poles": (modes, 2),
        "drive": (modes, 2, m),
        "force": (modes, 2, n),
        "sensed": (n, modes, 2),
        "through": (n, m),
        "weights": (n, functions),
        "play_weights": (m, plays),
        "seen": (p, modes, 2),
        "direct": (p, m),
    }


@njit
def _put(tangents: np.ndarray, at: int, value: float) -> None:
    """Add the direct part of a slope, where the parameter is among those carried."""
    if 0 <= at < len(tangents):
        tangents[at] += value


@njit
def _single(rows: int, size: int) -> np.ndarray:
    return np.zeros((rows, size), np.float32)


@njit
def modal_feedback(
    u: np.ndarray,  # (time, inputs)
    k: np.ndarray,  # (time, inputs, input plays)
    poles: np.ndarray,  # (modes, 2)
    drive: np.ndarray,  # (modes, 2, inputs)
    force: np.ndarray,  # (modes, 2, elements)
    sensed: np.ndarray,  # (elements, modes, 2)
    through: np.ndarray,  # (elements, inputs)
    weights: np.ndarray,  # (elements, functions)
    play_weights: np.ndarray,  # (inputs, input plays)
    seen: np.ndarray,  # (outputs, modes, 2)
    direct: np.ndarray,  # (outputs, inputs)
    zones: np.ndarray,  # (dead zones,), thresholds
    thresholds: np.ndarray,  # (plays,)
    shares: np.ndarray,  # (means,), of a sample in its mean
    x: np.ndarray,  # (modes, 2), state; left as after the last sample, like those below
    h: np.ndarray,  # (elements, plays)
    means: np.ndarray,  # (elements, means)
    past: int,  # samples before these
    y: np.ndarray,  # (time, outputs), written
    first: int,  # sample from which tangents are carried
    counted: int,  # sample from which the error counts
    error: np.ndarray,  # (time, outputs)
    stride: int,  # every how many samples a row of slopes is kept
    low: int,  # first parameter whose tangent is carried
    gradient: np.ndarray,  # (tangents,), added to; of length 0: no tangents
    total: np.ndarray,  # (outputs, tangents), added to: slopes summed over all counted samples
    slopes: np.ndarray,  # (rows, outputs, tangents), written
) -> bool:
    """Fill `y`, and with a gradient the tangents; False where the states leave all bounds.

    A few tangents at a time are quicker than many: their states then stay in the nearest cache. They are
    in single precision, of which twice as many fit; states and sums are not.
    """
    samples, inputs = u.shape
    modes, elements, functions = len(poles), len(weights), weights.shape[1]
    outputs, plays, input_plays = len(seen), len(thresholds), k.shape[2]
    at_force = 2 * modes * (1 + inputs)
    at_sensed = at_force + 2 * modes * elements
    at_through = at_sensed + 2 * modes * elements
    at_weights = at_through + elements * inputs
    at_plays = at_weights + elements * functions
    moving = at_plays + inputs * input_plays  # parameters before these move the states
    size = len(gradient)
    at_drive, tangents = 2 * modes, size > 0
    dx, dz, dw = _single(2 * modes, size), _single(elements, size), _single(elements, size)
    dh, dm = _single(elements * plays, size), _single(elements * len(shares), size)
    row = np.zeros(size, np.float32)
    v, z, w, phi = np.zeros(inputs), np.zeros(elements), np.zeros(elements), np.zeros((elements, functions))
    after_zones, after_plays = len(zones), len(zones) + plays
    after_means = after_plays + len(shares)
    for t in range(samples):
        seeing = tangents and t >= counted
        carried = tangents and t >= first and low < moving
        for i in range(inputs):
            v[i] = u[t, i]
            for r in range(input_plays):
                v[i] += play_weights[i, r] * k[t, i, r]
        for n in range(elements):
            sum_ = 0.0
            for m in range(modes):
                sum_ += sensed[n, m, 0] * x[m, 0] + sensed[n, m, 1] * x[m, 1]
            for i in range(inputs):
                sum_ += through[n, i] * v[i]
            z[n] = sum_
            if not abs(sum_) < DIVERGED:
                return False
            if carried:
                d = dz[n]
                d[:] = 0.0
                for m in range(modes):
                    for c in range(2):
                        a, other = np.float32(sensed[n, m, c]), dx[2 * m + c]
                        for j in range(size):
                            d[j] += a * other[j]
                        _put(d, at_sensed + (n * modes + m) * 2 + c - low, x[m, c])
                for i in range(inputs):
                    _put(d, at_through + n * inputs + i - low, v[i])
                    for r in range(input_plays):
                        _put(d, at_plays + i * input_plays + r - low, through[n, i] * k[t, i, r])
            value, slope = z[n], 0.0
            for q in range(len(zones)):
                e = value - zones[q]
                active = e > 0 if zones[q] >= 0 else e < 0
                phi[n, q] = e if active else 0.0
                slope += weights[n, q] if active else 0.0
            for r in range(plays):
                before = h[n, r]
                h[n, r] = _play(value, thresholds[r], before)
                phi[n, after_zones + r] = h[n, r] - value
                slope -= weights[n, after_zones + r]
                if carried and h[n, r] != before:
                    dh[n * plays + r, :] = dz[n]
            for q in range(len(shares)):
                share = max(shares[q], 1.0 / (past + t + 1))
                means[n, q] += share * (abs(value) - means[n, q])
                root = np.sqrt(means[n, q] + SMALLEST_MEAN)
                phi[n, after_plays + q] = value * root
                slope += weights[n, after_plays + q] * root
                if carried:
                    d, other = dm[n * len(shares) + q], dz[n]
                    kept, sign = np.float32(share), np.float32(share if value > 0 else -share)
                    for j in range(size):
                        d[j] += sign * other[j] - kept * d[j]
            for r in range(input_plays):
                phi[n, after_means + r] = value * k[t, n % inputs, r]
                slope += weights[n, after_means + r] * k[t, n % inputs, r]
            sum_ = 0.0
            for q in range(functions):
                sum_ += weights[n, q] * phi[n, q]
            w[n] = sum_
            if carried:
                d, other = dw[n], dz[n]
                a = np.float32(slope)
                for j in range(size):
                    d[j] = a * other[j]
                for r in range(plays):
                    a, other = np.float32(weights[n, after_zones + r]), dh[n * plays + r]
                    for j in range(size):
                        d[j] += a * other[j]
                for q in range(len(shares)):
                    root = np.sqrt(means[n, q] + SMALLEST_MEAN)
                    a = np.float32(weights[n, after_plays + q] * value * 0.5 / root)
                    other = dm[n * len(shares) + q]
                    for j in range(size):
                        d[j] += a * other[j]
                for q in range(functions):
                    _put(d, at_weights + n * functions + q - low, phi[n, q])
        for o in range(outputs):
            sum_ = 0.0
            for m in range(modes):
                sum_ += seen[o, m, 0] * x[m, 0] + seen[o, m, 1] * x[m, 1]
            for i in range(inputs):
                sum_ += direct[o, i] * v[i]
            y[t, o] = sum_
            if seeing:
                row[:] = 0.0
                for m in range(modes):
                    for c in range(2):
                        if carried:
                            a, other = np.float32(seen[o, m, c]), dx[2 * m + c]
                            for j in range(size):
                                row[j] += a * other[j]
                        _put(row, moving + (o * modes + m) * 2 + c - low, x[m, c])
                for i in range(inputs):
                    _put(row, moving + outputs * 2 * modes + o * inputs + i - low, v[i])
                    for r in range(input_plays):
                        _put(row, at_plays + i * input_plays + r - low, direct[o, i] * k[t, i, r])
                e = error[t, o]
                for j in range(size):
                    gradient[j] += e * row[j]
                    total[o, j] += row[j]
                # Rows of the outputs are taken at different samples.
                if (t - counted) % stride == o % stride and (t - counted) // stride < len(slopes):
                    slopes[(t - counted) // stride, o, :] = row
        for m in range(modes):
            re, im = poles[m, 0], poles[m, 1]
            x0, x1 = x[m, 0], x[m, 1]
            f0, f1 = 0.0, 0.0
            for i in range(inputs):
                f0 += drive[m, 0, i] * v[i]
                f1 += drive[m, 1, i] * v[i]
            for n in range(elements):
                f0 += force[m, 0, n] * w[n]
                f1 += force[m, 1, n] * w[n]
            x[m, 0], x[m, 1] = re * x0 - im * x1 + f0, im * x0 + re * x1 + f1
            if carried:
                d0, d1 = dx[2 * m], dx[2 * m + 1]
                a, b = np.float32(re), np.float32(im)
                for j in range(size):
                    s0, s1 = d0[j], d1[j]
                    d0[j], d1[j] = a * s0 - b * s1, b * s0 + a * s1
                for n in range(elements):
                    a, b, other = np.float32(force[m, 0, n]), np.float32(force[m, 1, n]), dw[n]
                    for j in range(size):
                        d0[j] += a * other[j]
                        d1[j] += b * other[j]
                    _put(d0, at_force + 2 * m * elements + n - low, w[n])
                    _put(d1, at_force + (2 * m + 1) * elements + n - low, w[n])
                _put(d0, 2 * m - low, x0)
                _put(d1, 2 * m - low, x1)
                _put(d0, 2 * m + 1 - low, -x1)
                _put(d1, 2 * m + 1 - low, x0)
                for i in range(inputs):
                    _put(d0, at_drive + 2 * m * inputs + i - low, v[i])
                    _put(d1, at_drive + (2 * m + 1) * inputs + i - low, v[i])
                    for r in range(input_plays):
                        _put(d0, at_plays + i * input_plays + r - low, drive[m, 0, i] * k[t, i, r])
                        _put(d1, at_plays + i * input_plays + r - low, drive[m, 1, i] * k[t, i, r])
    return True
