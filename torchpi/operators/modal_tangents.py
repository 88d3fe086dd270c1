"""Exact derivatives of `modal_feedback` with respect to its parameters, from a record of its states.

The gradient of an error is computed backwards in time and costs as much as a few simulations. The slopes of
the outputs, from which a normal matrix is formed, are computed forwards in time and cost in proportion to
the number of parameters.
"""

import numpy as np

from torchpi.operators.compiled import njit, njit_sum
from torchpi.operators.modal_feedback import Constants, Parameters, record_places


@njit
def _put(tangents: np.ndarray, at: int, value: float) -> None:
    """Add the direct part of a slope if its parameter is among those carried."""
    if 0 <= at < len(tangents):
        tangents[at] += value


@njit
def _single(rows: int, size: int) -> np.ndarray:
    return np.zeros((rows, size), np.float32)


@njit_sum
def _add_rows(into: np.ndarray, rows: np.ndarray, factors: np.ndarray) -> None:
    """Compute into += factors @ rows, four rows at a time, so that `into` is fetched less often."""
    size, k = len(into), 0
    while k + 4 <= len(factors):
        a, b, c, d = factors[k], factors[k + 1], factors[k + 2], factors[k + 3]
        p, q, r, s = rows[k], rows[k + 1], rows[k + 2], rows[k + 3]
        for j in range(size):
            into[j] += (a * p[j] + b * q[j]) + (c * r[j] + d * s[j])
        k += 4
    while k < len(factors):
        a, p = factors[k], rows[k]
        for j in range(size):
            into[j] += a * p[j]
        k += 1


@njit
def modal_tangents(
    record: np.ndarray,  # (time, record width), from the first sample whose tangents are carried
    k: np.ndarray,  # (time, inputs, input plays), of the same
    parameters: Parameters,
    constants: Constants,
    past: int,  # samples before these
    counted: int,  # number of samples at the end whose slopes count
    stride: int,  # samples from one row of slopes to the next
    low: int,  # first parameter whose tangent is carried
    slopes: np.ndarray,  # (rows, outputs, tangents), written
) -> None:
    """Compute the rows of slopes for the normal matrix.

    A few tangents at a time are faster than many, because their states then stay in the nearest cache. They
    are in single precision, so that twice as many fit.
    """
    poles, drive, force, sensed, through, weights, _, seen, direct = parameters
    zones, thresholds, _, shares = constants
    inputs, modes, elements, functions = drive.shape[2], len(poles), len(weights), weights.shape[1]
    outputs, plays, input_plays, averages = len(seen), len(thresholds), k.shape[2], len(shares)
    after_zones, after_means = len(zones), functions - 1
    # Indices at which the parameters of each name begin, and which of them are carried.
    at_drive = 2 * modes
    at_force = at_drive + 2 * modes * inputs
    at_sensed = at_force + 2 * modes * elements
    at_through = at_sensed + 2 * modes * elements
    at_weights = at_through + elements * inputs
    at_plays = at_weights + elements * functions
    moving = at_plays + inputs * input_plays  # parameters before these move the states
    size = slopes.shape[2]
    high, carried = low + size, low < moving
    of_modes, of_force = low < at_force, low < at_sensed and high > at_force
    of_sensed, of_weights = low < at_through and high > at_sensed, low < at_plays and high > at_through
    of_plays = low < moving and high > at_plays
    at_x, at_phi, at_z, at_slope, at_play_slopes, at_mean_slopes, at_w, _ = record_places(
        inputs, modes, elements, functions, plays, averages
    )
    dx, dz, dw = _single(2 * modes, size), _single(elements, size), _single(elements, size)
    dh, dm = _single(elements * plays, size), _single(elements * averages, size)
    row = np.zeros(size, np.float32)
    sensed_, force_ = sensed.reshape(elements, 2 * modes).astype(np.float32), force.astype(np.float32)
    weights_, seen_ = weights.astype(np.float32), seen.reshape(outputs, 2 * modes).astype(np.float32)
    silent = len(record) - counted
    for t in range(len(record)):
        now = record[t]
        v, x, phi, w = now[:at_x], now[at_x:at_phi], now[at_phi:at_z], now[at_w:]
        if carried:
            for n in range(elements):
                d, value, own = dz[n], now[at_z + n], n % inputs
                d[:] = 0.0
                _add_rows(d, dx, sensed_[n])
                if of_sensed:
                    for c in range(2 * modes):
                        _put(d, at_sensed + n * 2 * modes + c - low, x[c])
                if of_weights:
                    for i in range(inputs):
                        _put(d, at_through + n * inputs + i - low, v[i])
                if of_plays:
                    for i in range(inputs):
                        for r in range(input_plays):
                            _put(d, at_plays + i * input_plays + r - low, through[n, i] * k[t, i, r])
                force_of, a = dw[n], np.float32(now[at_slope + n])
                for j in range(size):
                    force_of[j] = a * d[j]
                for r in range(plays):
                    a = np.float32(now[at_play_slopes + n * plays + r])
                    b, c_, state = np.float32(1.0) - a, weights_[n, after_zones + r], dh[n * plays + r]
                    for j in range(size):
                        state[j] = a * state[j] + b * d[j]
                        force_of[j] += c_ * state[j]
                for q in range(averages):
                    share = max(shares[q], 1.0 / (past + t + 1))
                    a, b = np.float32(share), np.float32(share if value > 0 else -share)
                    c_, state = np.float32(now[at_mean_slopes + n * averages + q]), dm[n * averages + q]
                    for j in range(size):
                        state[j] += b * d[j] - a * state[j]
                        force_of[j] += c_ * state[j]
                if of_weights:
                    for q in range(functions):
                        _put(force_of, at_weights + n * functions + q - low, phi[n * functions + q])
                if of_plays:
                    for r in range(input_plays):
                        at = at_plays + own * input_plays + r - low
                        _put(force_of, at, weights[n, after_means] * value * k[t, own, r])
        at_row = (t - silent) // stride
        if 0 <= at_row < len(slopes):
            # Rows of the outputs are taken at different samples.
            for o in range(outputs):
                if (t - silent) % stride != o % stride:
                    continue
                row[:] = 0.0
                if carried:
                    _add_rows(row, dx, seen_[o])
                if of_plays:
                    for i in range(inputs):
                        for r in range(input_plays):
                            _put(row, at_plays + i * input_plays + r - low, direct[o, i] * k[t, i, r])
                if high > moving:
                    for c in range(2 * modes):
                        _put(row, moving + o * 2 * modes + c - low, x[c])
                    for i in range(inputs):
                        _put(row, moving + outputs * 2 * modes + o * inputs + i - low, v[i])
                slopes[at_row, o, :] = row
        if carried:
            for m in range(modes):
                d0, d1 = dx[2 * m], dx[2 * m + 1]
                a, b = np.float32(poles[m, 0]), np.float32(poles[m, 1])
                for j in range(size):
                    s0, s1 = d0[j], d1[j]
                    d0[j], d1[j] = a * s0 - b * s1, b * s0 + a * s1
                _add_rows(d0, dw, force_[m, 0])
                _add_rows(d1, dw, force_[m, 1])
                if of_force:
                    for n in range(elements):
                        _put(d0, at_force + 2 * m * elements + n - low, w[n])
                        _put(d1, at_force + (2 * m + 1) * elements + n - low, w[n])
                if of_modes:
                    _put(d0, 2 * m - low, x[2 * m])
                    _put(d1, 2 * m - low, x[2 * m + 1])
                    _put(d0, 2 * m + 1 - low, -x[2 * m + 1])
                    _put(d1, 2 * m + 1 - low, x[2 * m])
                    for i in range(inputs):
                        _put(d0, at_drive + 2 * m * inputs + i - low, v[i])
                        _put(d1, at_drive + (2 * m + 1) * inputs + i - low, v[i])
                if of_plays:
                    for i in range(inputs):
                        for r in range(input_plays):
                            at = at_plays + i * input_plays + r - low
                            _put(d0, at, drive[m, 0, i] * k[t, i, r])
                            _put(d1, at, drive[m, 1, i] * k[t, i, r])


@njit
def modal_gradient(
    record: np.ndarray,  # (time, record width), of the samples through which the error is traced back
    k: np.ndarray,  # (time, inputs, input plays), of the same
    parameters: Parameters,
    constants: Constants,
    past: int,  # samples before these
    error: np.ndarray,  # (counted, outputs), of the last samples
    d: Parameters,  # slopes, added to
) -> None:
    """Add Σ error · ∂y/∂parameter to `d`, by the adjoint recursion."""
    poles, drive, force, sensed, through, weights, _, seen, direct = parameters
    zones, thresholds, _, shares = constants
    inputs, modes, elements, functions = drive.shape[2], len(poles), len(weights), weights.shape[1]
    outputs, plays, input_plays, averages = len(seen), len(thresholds), k.shape[2], len(shares)
    after_zones, after_means = len(zones), functions - 1
    at_x, at_phi, at_z, at_slope, at_play_slopes, at_mean_slopes, at_w, _ = record_places(
        inputs, modes, elements, functions, plays, averages
    )
    # Adjoints of the states after a sample, of the sensed signals, of the forces and of the inputs.
    ax, ah, am = np.zeros((modes, 2)), np.zeros((elements, plays)), np.zeros((elements, averages))
    az, aw, av = np.zeros(elements), np.zeros(elements), np.zeros(inputs)
    silent = len(record) - len(error)
    for t in range(len(record) - 1, -1, -1):
        now = record[t]
        v, z, w = now[:at_x], now[at_z:at_slope], now[at_w:]
        x, phi = now[at_x:at_phi].reshape(modes, 2), now[at_phi:at_z].reshape(elements, functions)
        av[:] = 0.0
        aw[:] = 0.0
        for m in range(modes):
            for c in range(2):
                a = ax[m, c]
                for i in range(inputs):
                    av[i] += drive[m, c, i] * a
                    d.drive[m, c, i] += a * v[i]
                for n in range(elements):
                    aw[n] += force[m, c, n] * a
                    d.force[m, c, n] += a * w[n]
            d.poles[m, 0] += ax[m, 0] * x[m, 0] + ax[m, 1] * x[m, 1]
            d.poles[m, 1] += ax[m, 1] * x[m, 0] - ax[m, 0] * x[m, 1]
            re, im, a0, a1 = poles[m, 0], poles[m, 1], ax[m, 0], ax[m, 1]
            ax[m, 0], ax[m, 1] = re * a0 + im * a1, re * a1 - im * a0
        for n in range(elements):
            sum_ = now[at_slope + n] * aw[n]
            for r in range(plays):
                kept_of = now[at_play_slopes + n * plays + r]
                a = ah[n, r] + weights[n, after_zones + r] * aw[n]
                sum_ += (1.0 - kept_of) * a
                ah[n, r] = kept_of * a
            for q in range(averages):
                share = max(shares[q], 1.0 / (past + t + 1))
                a = am[n, q] + now[at_mean_slopes + n * averages + q] * aw[n]
                sum_ += (share if z[n] > 0 else -share) * a
                am[n, q] = (1.0 - share) * a
            az[n] = sum_
            for q in range(functions):
                d.weights[n, q] += aw[n] * phi[n, q]
            av[n % inputs] += weights[n, after_means] * z[n] * aw[n]
            for m in range(modes):
                for c in range(2):
                    ax[m, c] += sensed[n, m, c] * sum_
                    d.sensed[n, m, c] += sum_ * x[m, c]
            for i in range(inputs):
                av[i] += through[n, i] * sum_
                d.through[n, i] += sum_ * v[i]
        if t >= silent:
            for o in range(outputs):
                e = error[t - silent, o]
                for m in range(modes):
                    for c in range(2):
                        ax[m, c] += seen[o, m, c] * e
                        d.seen[o, m, c] += e * x[m, c]
                for i in range(inputs):
                    av[i] += direct[o, i] * e
                    d.direct[o, i] += e * v[i]
        for i in range(inputs):
            for r in range(input_plays):
                d.play_weights[i, r] += av[i] * k[t, i, r]
