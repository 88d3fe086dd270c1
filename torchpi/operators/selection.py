"""Operators whose every output is one earlier input plus a constant: a play, a breakaway, a limited rate.

Their Jacobian is a selection: y(k) moves as x(source(k)) moves. The tangent gathers along it, the adjoint
scatters along it.
"""

import numba
import numpy as np
import torch
from torch import Tensor

NO_SOURCE = -1


def gather(
    dx: Tensor,  # (directions, time)
    source: np.ndarray,  # (time,), of the sample that each output follows; NO_SOURCE: none of them
) -> Tensor:  # (directions, time)
    """dy(k) = dx(source(k)), and 0 where the output still stands where it began."""
    dx = dx.detach().contiguous()
    dy = torch.empty_like(dx)
    _gather(dx.numpy(), source, dy.numpy())
    return dy


@numba.njit(cache=True)
def _gather(dx: np.ndarray, source: np.ndarray, dy: np.ndarray) -> None:
    for row in range(dx.shape[0]):
        for t in range(dx.shape[1]):
            dy[row, t] = dx[row, source[t]] if source[t] >= 0 else 0.0
