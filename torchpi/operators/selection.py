"""Operators each of whose outputs is one earlier input plus a constant: a play, a breakaway.

    y(k) = x(source(k)) + n(k) p,    or y(-1) + n(k) p before there is a source

Their Jacobian is a selection: y(k) changes as x(source(k)) does. The tangent gathers along it, the adjoint
scatters along it.
"""

from typing import Any, NamedTuple

import numba
import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

NO_SOURCE = -1


class Selected(NamedTuple):
    """Results of a kernel."""

    y: Tensor  # (batch, time)
    after: Tensor  # (batch, states): the last y first, then the last x if it is kept
    source: Tensor  # (batch, time), index of the sample that each output follows, or NO_SOURCE
    steps: Tensor  # (batch, time), n


def select(kernel: Any, x: Tensor, p: float, numbers: tuple[float, ...], state: Tensor) -> Selected:
    """Run a compiled kernel (x, p, *numbers, state, y, source, n), which writes the last four."""
    x, after = x.detach().contiguous(), state.detach().clone(memory_format=torch.contiguous_format)
    found = Selected(torch.empty_like(x), after, torch.empty_like(x, dtype=torch.int64), torch.empty_like(x))
    outputs = (found.after, found.y, found.source, found.steps)
    kernel(x.numpy(), p, *numbers, *(part.numpy() for part in outputs))
    return found


class Selection(torch.autograd.Function):
    """`select`, differentiable in x, p and the state."""

    @staticmethod
    def forward(
        ctx: Any, kernel: Any, x: Tensor, p: Tensor, numbers: tuple[float, ...], state: Tensor
    ) -> tuple[Tensor, Tensor]:
        found = select(kernel, x, p.item(), numbers, state)
        ctx.save_for_backward(found.source, found.steps)
        return found.y, found.after

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        source, steps = ctx.saved_tensors
        gy, gstate = gradients[0].clone(), torch.zeros_like(gradients[1])
        gy[:, -1] += gradients[1][:, 0]
        follows = source >= 0
        gx = torch.zeros_like(gy).scatter_add_(1, source.clamp(min=0), gy * follows)
        gx[:, -1] += gradients[1][:, 1:2].sum(1)
        gstate[:, 0] = (gy * ~follows).sum(1)
        return None, gx, (gy * steps).sum(), None, gstate


def gather(
    dx: Tensor,  # (directions, time)
    source: np.ndarray,  # (time,), index of the sample that each output follows, or NO_SOURCE
) -> Tensor:  # (directions, time)
    """Return dy(k) = dx(source(k)), or 0 while the output still has its initial value."""
    dx = dx.detach().contiguous()
    dy = torch.empty_like(dx)
    _gather(dx.numpy(), source, dy.numpy())
    return dy


@numba.njit(cache=True)
def _gather(dx: np.ndarray, source: np.ndarray, dy: np.ndarray) -> None:
    for row in range(dx.shape[0]):
        for t in range(dx.shape[1]):
            dy[row, t] = dx[row, source[t]] if source[t] >= 0 else 0.0
