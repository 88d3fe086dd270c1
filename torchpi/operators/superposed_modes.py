"""Compiled parallel modes over whole records: their sum, and the states that a fit of modes needs.

There are no gradients: `state_space` provides them, one mode at a time, with the same bits.
"""

import numpy as np

from torchpi.operators.compiled import njit

LANES = 8
"""Rows that are processed in parallel."""


@njit
def superposed(
    u: np.ndarray,  # (rows, time)
    a: np.ndarray,  # (modes, 2, 2)
    b: np.ndarray,  # (modes, 2)
    c: np.ndarray,  # (modes, 2, inputs)
    d: np.ndarray,  # (modes, inputs)
    direct: np.ndarray,  # (inputs,)
    inputs: np.ndarray,  # (rows,), integer: which input a row is
    x: np.ndarray,  # (rows, modes, 2), the initial states; replaced by the final ones
    y: np.ndarray,  # (rows, time), written
) -> None:
    """Compute y = direct u + Σ_m (C_m x_m + D_m u), x_m⁺ = A_m x_m + B_m u, for each row separately."""
    modes = len(b)
    residue, through, past = np.zeros((modes, 2, LANES)), np.zeros((modes, LANES)), np.zeros(LANES)
    first_state, second_state = np.zeros((modes, LANES)), np.zeros((modes, LANES))
    sample, total = np.zeros(LANES), np.zeros(LANES)
    for first in range(0, len(u), LANES):
        rows = min(LANES, len(u) - first)
        for r in range(rows):
            k = inputs[first + r]
            past[r] = direct[k]
            for m in range(modes):
                residue[m, 0, r], residue[m, 1, r], through[m, r] = c[m, 0, k], c[m, 1, k], d[m, k]
                first_state[m, r], second_state[m, r] = x[first + r, m, 0], x[first + r, m, 1]
        for t in range(u.shape[1]):
            for r in range(rows):
                sample[r] = u[first + r, t]
            for r in range(LANES):
                total[r] = past[r] * sample[r]
            for m in range(modes):
                a00, a01, a10, a11 = a[m, 0, 0], a[m, 0, 1], a[m, 1, 0], a[m, 1, 1]
                b0, b1 = b[m, 0], b[m, 1]
                for r in range(LANES):
                    x0, x1, s = first_state[m, r], second_state[m, r], sample[r]
                    total[r] = total[r] + (residue[m, 0, r] * x0 + residue[m, 1, r] * x1 + through[m, r] * s)
                    first_state[m, r] = a00 * x0 + a01 * x1 + b0 * s
                    second_state[m, r] = a10 * x0 + a11 * x1 + b1 * s
            for r in range(rows):
                y[first + r, t] = total[r]
        for m in range(modes):
            for r in range(rows):
                x[first + r, m, 0], x[first + r, m, 1] = first_state[m, r], second_state[m, r]


@njit
def mode_states(
    u: np.ndarray,  # (inputs, time)
    a: np.ndarray,  # (modes, 2, 2)
    b: np.ndarray,  # (modes, 2)
    d: np.ndarray,  # (modes, 2)
    states: np.ndarray,  # (inputs, modes, 2, time), written: x + d u, with x⁺ = A x + B u from rest
) -> None:
    """Compute both states of each mode for each input."""
    for k in range(u.shape[0]):
        for m in range(a.shape[0]):
            a00, a01, a10, a11 = a[m, 0, 0], a[m, 0, 1], a[m, 1, 0], a[m, 1, 1]
            b0, b1, d0, d1 = b[m, 0], b[m, 1], d[m, 0], d[m, 1]
            x0, x1 = 0.0, 0.0
            for t in range(u.shape[1]):
                sample = u[k, t]
                states[k, m, 0, t] = x0 + d0 * sample
                states[k, m, 1, t] = x1 + d1 * sample
                x0, x1 = a00 * x0 + a01 * x1 + b0 * sample, a10 * x0 + a11 * x1 + b1 * sample
