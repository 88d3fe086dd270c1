"""A linear block with fixed matrices, run many times: the kernels without tensors, gradients or checks."""

from typing import Any

import numba
import numpy as np

from torchpi.operators import linear, relaxations
from torchpi.operators.linear import LANES, Matrices

TILE = 512
"""Samples at a time, so that what the kernels read and write stays in the cache."""


class DiscreteBlock:
    """x⁺ = A x + B u, y = C x + D u, at rest at the first sample; the bits are those of `state_space` and
    `relaxations` for deviations from it.

    Args:
        matrices: A (n, n), or (n,) if it is diagonal, B (n,), C (n,), D (); float64, on the CPU.
    """

    def __init__(self, matrices: Matrices) -> None:
        a, b, c, d = (part.detach().contiguous().numpy() for part in matrices)
        self.diagonal = a.ndim == 1
        self.fixed = a.ravel(), b, c, float(d)

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """Return the response, (rows, time), to rows, (rows, time). Each is taken to have had its first value
        for a long time, which passes unchanged."""
        y = np.empty_like(u)
        _of_deviations(u, self.diagonal, *self.fixed, y)
        return y


_relaxations: Any = relaxations.response
_linear: Any = linear.response


@numba.njit(cache=True)
def _of_deviations(
    u: np.ndarray, diagonal: bool, a: np.ndarray, b: np.ndarray, c: np.ndarray, d: float, y: np.ndarray
) -> None:
    moved, response = np.empty(LANES * TILE), np.empty(LANES * TILE)
    for first in range(0, u.shape[0], LANES):
        rows = min(LANES, u.shape[0] - first)
        x, no_states = np.zeros((rows, len(b))), np.empty((rows, 0, len(b)))
        for begin in range(0, u.shape[1], TILE):
            samples = min(TILE, u.shape[1] - begin)
            part = moved[: rows * samples].reshape(rows, samples)
            out = response[: rows * samples].reshape(rows, samples)
            for r in range(rows):
                row, to = u[first + r], part[r]
                for t in range(samples):
                    to[t] = row[begin + t] - row[0]
            if diagonal:
                _relaxations(part, a, b, c, d, x, out, no_states)
            else:
                _linear(part, a, b, c, d, x, out, no_states)
            for r in range(rows):
                level, row, to = u[first + r, 0], out[r], y[first + r]
                for t in range(samples):
                    to[begin + t] = row[t] + level
