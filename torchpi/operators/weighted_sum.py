"""The weighted sum of play states, Qin et al. (2013), eq. 3 and 8: Σ_i w_i h_i, weights moving with the rate.

Every weight is a linear form of a basis of the input rate, w_i = Σ_m θ_im φ_m: the basis (1) gives
eq. 3, (1, ẏ) gives eq. 7 and 8, and more functions of the rate give the neural head.
"""

from typing import Any, cast

import numba
import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx, once_differentiable


def weighted_sum(
    h: Tensor,  # (batch, time, plays)
    basis: Tensor,  # φ: (batch, time, functions)
    theta: Tensor,  # θ: (plays, functions)
) -> Tensor:  # (batch, time)
    """Σ_i (Σ_m θ_im φ_m) h_i, summed left to right, differentiable in all three arguments."""
    device = h.device
    return cast(Tensor, _WeightedSum.apply(h.cpu(), basis.cpu(), theta.cpu())).to(device)


def weight(theta: list[float], basis: list[float], i: int) -> float:
    """w_i = Σ_m θ_im φ_m; `theta` is flat, play by play. The kernel and the streams compile this."""
    w = 0.0
    for m in range(len(basis)):
        w += theta[i * len(basis) + m] * basis[m]
    return w


class _WeightedSum(torch.autograd.Function):
    @staticmethod
    def forward(ctx: FunctionCtx, h: Tensor, basis: Tensor, theta: Tensor) -> Tensor:
        h, basis, theta = h.contiguous(), basis.contiguous(), theta.contiguous()
        y = torch.empty(h.shape[:2], dtype=h.dtype)
        _forward(h.detach().numpy(), basis.detach().numpy(), theta.detach().flatten().numpy(), y.numpy())
        ctx.save_for_backward(h, basis, theta)
        return y

    @staticmethod
    @once_differentiable
    def backward(ctx: FunctionCtx, *gradients: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        h, basis, theta = (saved.detach() for saved in ctx.saved_tensors)  # type: ignore[attr-defined]
        gy = gradients[0].contiguous()
        gh, gbasis, gtheta = torch.empty_like(h), torch.empty_like(basis), torch.zeros_like(theta)
        _backward(
            h.numpy(), basis.numpy(), theta.numpy(), gy.numpy(), gh.numpy(), gbasis.numpy(), gtheta.numpy()
        )
        return gh, gbasis, gtheta


_weight: Any = numba.njit(weight)


@numba.njit(cache=True)
def _forward(h: np.ndarray, basis: np.ndarray, theta: np.ndarray, y: np.ndarray) -> None:
    for batch in range(h.shape[0]):
        for t in range(h.shape[1]):
            total = 0.0
            for i in range(h.shape[2]):
                total += _weight(theta, basis[batch, t], i) * h[batch, t, i]
            y[batch, t] = total


@numba.njit(cache=True)
def _backward(
    h: np.ndarray, basis: np.ndarray, theta: np.ndarray, gy: np.ndarray,
    gh: np.ndarray, gbasis: np.ndarray, gtheta: np.ndarray,
) -> None:  # fmt: skip
    for batch in range(h.shape[0]):
        for t in range(h.shape[1]):
            g = gy[batch, t]
            for m in range(basis.shape[2]):
                gbasis[batch, t, m] = 0
            for i in range(h.shape[2]):
                w = 0.0
                gw = g * h[batch, t, i]
                for m in range(basis.shape[2]):
                    w += theta[i, m] * basis[batch, t, m]
                    gbasis[batch, t, m] += theta[i, m] * gw
                    gtheta[i, m] += basis[batch, t, m] * gw
                gh[batch, t, i] = w * g
