"""Modes with hysteretic feedback, m inputs and p outputs, sampled: the compiled step.

    v_i  = u_i + Σ_r g_ir k_ir                    k_ir, given, added to the inputs by plays and amplifiers
    z_n  = Σ_m a_nm · x_m + Σ_i f_ni v_i          sensed by the nonlinear element n
    w_n  = Σ_j θ_nj φ_nj(z_n)                     its force
    x_m⁺ = Λ_m x_m + Σ_i b_mi v_i + Σ_n e_mn w_n  modes, pairs of real states, Λ = [[α, -β], [β, α]]
    y_o  = Σ_m c_om · x_m + Σ_i d_oi v_i + Σ_ij a_oij u_i(t + j)

The functions φ of an element, in this order: dead zones, max(z - r, 0) for r ≥ 0 and min(z - r, 0) for r < 0;
relaxing plays minus their input, h - z; z √s_τ, with s_τ the mean of |z| over a time τ, a stiffness that
follows the amplitude slowly; and z v_i for its own input (i = n mod m), a stiffness that follows the voltage.
Plays and dead zones in superposition: Kuhnen, European J. Control 9(4), 2003; the linear part with feedback
around it: Paduart et al., Automatica 46(4), 2010.

The last sum, j from 1, accounts for band-limited voltages: the modes respond as if voltages were held between
samples, whereas a voltage without content beyond the Nyquist frequency depends there on the samples on either
side (Pintelon and Schoukens, System Identification, 2012, ch. 13). The difference is smooth over the band, so
that a short non-causal filter describes it. `foreseen` computes this sum, the kernel the rest.
"""

from typing import NamedTuple

import numpy as np

from torchpi.operators.compiled import njit
from torchpi.operators.filters import filter_matrix
from torchpi.operators.relaxing_play import relaxing_play, relaxing_play_slope

SMALLEST_MEAN = 1e-4
"""Added to the mean of |z| under the root, because the slope of the root is unbounded at 0."""
DIVERGED = 1e6
_play, _play_slope = njit(relaxing_play), njit(relaxing_play_slope)


class Shapes(NamedTuple):
    """Numbers that set the shapes of the parameters."""

    inputs: int
    outputs: int
    modes: int
    elements: int
    functions: int
    input_plays: int
    ahead: int = 0


class Parameters(NamedTuple):
    """The kernel's parameters, or derivatives with respect to them, in the order that a fit uses."""

    poles: np.ndarray  # (modes, 2)
    drive: np.ndarray  # (modes, 2, inputs)
    force: np.ndarray  # (modes, 2, elements)
    sensed: np.ndarray  # (elements, modes, 2)
    through: np.ndarray  # (elements, inputs)
    weights: np.ndarray  # (elements, functions)
    play_weights: np.ndarray  # (inputs, input plays)
    seen: np.ndarray  # (outputs, modes, 2)
    direct: np.ndarray  # (outputs, inputs)


class Constants(NamedTuple):
    """Constants of the functions φ of the elements."""

    zones: np.ndarray  # (dead zones,), thresholds
    thresholds: np.ndarray  # (plays,)
    kept: np.ndarray  # (plays,), factor by which small deviations decay in a sample
    shares: np.ndarray  # (means,), weight of a sample in its mean


def parameter_shapes(shapes: Shapes) -> dict[str, tuple[int, ...]]:
    """Return the shapes of all parameters by name: those of `Parameters` in its order, then a."""
    m, p, modes, n, functions, plays, ahead = shapes
    each = (
        (modes, 2), (modes, 2, m), (modes, 2, n), (n, modes, 2), (n, m), (n, functions), (m, plays),
        (p, modes, 2), (p, m), (p, m, ahead),
    )  # fmt: skip
    return dict(zip((*Parameters._fields, "ahead"), each, strict=True))


def foreseen(u: np.ndarray, ahead: np.ndarray) -> np.ndarray:
    """Return Σ_ij a_oij u_i(t + j), (time, outputs), for voltages (time + number of j, inputs)."""
    found = np.empty((len(u) - ahead.shape[2], len(ahead)))
    filter_matrix(u[1:], np.ascontiguousarray(ahead.transpose(2, 0, 1)[::-1]), found)
    return found


@njit
def record_places(
    inputs: int, modes: int, elements: int, functions: int, plays: int, means: int
) -> tuple[int, int, int, int, int, int, int, int]:
    """Return where the parts of a sample begin in a record, which `modal_tangents` reads, and its width.

    After v they are x, φ, z, the slope of the force without plays and means, the slopes of these, and w.
    """
    at_phi = inputs + 2 * modes
    at_z = at_phi + elements * functions
    at_slope = at_z + elements
    at_play_slopes = at_slope + elements
    at_mean_slopes = at_play_slopes + elements * plays
    at_w = at_mean_slopes + elements * means
    return inputs, at_phi, at_z, at_slope, at_play_slopes, at_mean_slopes, at_w, at_w + elements


def record_width(shapes: Shapes, plays: int, means: int) -> int:
    """Return how many numbers a record holds per sample."""
    inputs, modes, elements, functions = shapes.inputs, shapes.modes, shapes.elements, shapes.functions
    return int(record_places(inputs, modes, elements, functions, plays, means)[-1])


@njit
def modal_feedback(
    u: np.ndarray,  # (time, inputs)
    k: np.ndarray,  # (time, inputs, input plays)
    parameters: Parameters,
    constants: Constants,
    x: np.ndarray,  # (modes, 2), state; updated in place, like those below
    h: np.ndarray,  # (elements, plays)
    means: np.ndarray,  # (elements, means)
    past: int,  # samples before these
    y: np.ndarray,  # (time, outputs), written
    record: np.ndarray,  # (rows, record width), written: what tangents need of the last samples
) -> bool:
    """Fill `y`; return False if the states diverge."""
    poles, drive, force, sensed, through, weights, play_weights, seen, direct = parameters
    zones, thresholds, kept, shares = constants
    samples, inputs = u.shape
    modes, elements, functions = len(poles), len(weights), weights.shape[1]
    outputs, plays, input_plays = len(seen), len(thresholds), k.shape[2]
    v, z, w = np.zeros(inputs), np.zeros(elements), np.zeros(elements)
    phi, slope = np.zeros((elements, functions)), np.zeros(elements)
    play_slopes, mean_slopes = np.zeros((elements, plays)), np.zeros((elements, len(shares)))
    after_zones, after_plays = len(zones), len(zones) + plays
    after_means = after_plays + len(shares)
    for t in range(samples):
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
            z[n] = value = sum_
            if not abs(value) < DIVERGED:
                return False
            slope[n] = weights[n, after_means] * v[n % inputs]
            phi[n, after_means] = value * v[n % inputs]
            for q in range(len(zones)):
                e = value - zones[q]
                active = e > 0 if zones[q] >= 0 else e < 0
                phi[n, q] = e if active else 0.0
                slope[n] += weights[n, q] if active else 0.0
            for r in range(plays):
                play_slopes[n, r] = _play_slope(value, thresholds[r], kept[r], h[n, r])
                h[n, r] = _play(value, thresholds[r], kept[r], h[n, r])
                phi[n, after_zones + r] = h[n, r] - value
                slope[n] -= weights[n, after_zones + r]
            for q in range(len(shares)):
                share = max(shares[q], 1.0 / (past + t + 1))
                means[n, q] += share * (abs(value) - means[n, q])
                root = np.sqrt(means[n, q] + SMALLEST_MEAN)
                phi[n, after_plays + q] = value * root
                slope[n] += weights[n, after_plays + q] * root
                mean_slopes[n, q] = weights[n, after_plays + q] * value * 0.5 / root
            w[n] = 0.0
            for q in range(functions):
                w[n] += weights[n, q] * phi[n, q]
        row = t - (samples - len(record))
        if row >= 0:
            at = 0
            for part in (v, x.ravel(), phi.ravel(), z, slope, play_slopes.ravel(), mean_slopes.ravel(), w):
                record[row, at : at + len(part)] = part
                at += len(part)
        for o in range(outputs):
            sum_ = 0.0
            for m in range(modes):
                sum_ += seen[o, m, 0] * x[m, 0] + seen[o, m, 1] * x[m, 1]
            for i in range(inputs):
                sum_ += direct[o, i] * v[i]
            y[t, o] = sum_
        for m in range(modes):
            re, im, x0, x1 = poles[m, 0], poles[m, 1], x[m, 0], x[m, 1]
            f0, f1 = 0.0, 0.0
            for i in range(inputs):
                f0 += drive[m, 0, i] * v[i]
                f1 += drive[m, 1, i] * v[i]
            for n in range(elements):
                f0 += force[m, 0, n] * w[n]
                f1 += force[m, 1, n] * w[n]
            x[m, 0], x[m, 1] = re * x0 - im * x1 + f0, im * x0 + re * x1 + f1
    return True
