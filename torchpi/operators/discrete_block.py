"""A linear block with fixed matrices, run many times: the kernels without tensors, gradients or checks."""

from typing import Any

import numpy as np

from torchpi.operators import linear, relaxations
from torchpi.operators.linear import Matrices


class DiscreteBlock:
    """x⁺ = A x + B u, y = C x + D u from rest; bit-identical to `state_space` and `relaxations`.

    Args:
        matrices: A (n, n), or (n,) if it is diagonal, B (n,), C (n,), D (); float64, on the CPU.
    """

    def __init__(self, matrices: Matrices) -> None:
        a, b, c, d = (part.detach().contiguous().numpy() for part in matrices)
        self.kernel: Any = relaxations.response if a.ndim == 1 else linear.response
        self.fixed = a.ravel(), b, c, float(d)
        self.order = len(b)

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """Return the response, (rows, time), to rows of inputs, (rows, time)."""
        y, rows = np.empty_like(u), len(u)
        self.kernel(u, *self.fixed, np.zeros((rows, self.order)), y, np.empty((rows, 0, self.order)))
        return y
