"""The weighted sum of play states, Qin et al. (2013), eq. 3 and 8, and of their output functions.

    y = Σ_i w_i h_i,   w_i = Σ_m θ_im φ_m(ẏ) + Σ_q ψ_iq z_i^q,   z_i = h_i / scale,  q = 1, 2, …

The basis (1) gives eq. 3, (1, ẏ) gives eq. 7 and 8, and more functions of the rate give the neural head.
With ψ every play has its own output function, g_i(h_i) = w_i h_i, which makes the sum a Preisach operator in
play form (extension; the paper has no ψ): loops may then be asymmetric and depend on the bias.
"""

from typing import Any, cast

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from torchpi.operators.compiled import HAS_COMPILER, njit


def weighted_sum(
    h: Tensor,  # (batch, time, plays), any unit
    basis: Tensor,  # φ: (batch, time, functions), without unit
    theta: Tensor,  # θ: (plays, functions), units of the result per unit of h
    psi: Tensor | None = None,  # ψ: (plays, degree of the output functions - 1), the unit of θ
    scale: float = 1.0,  # scale of the play states in their output functions
) -> Tensor:  # (batch, time)
    """Return Σ_i w_i h_i, summed left to right, differentiable in all tensors.

    The CPU runs a compiled kernel; elsewhere or without Numba, plain torch gives the same bits.

    Example:
        >>> import torch
        >>> from torchpi.operators import weighted_sum
        >>> states, basis = torch.tensor([[[1.0, 0.5], [2.0, 1.5]]]), torch.ones(1, 2, 1)
        >>> weighted_sum(states, basis, theta=torch.tensor([[0.75], [0.25]])).tolist()
        [[0.875, 1.875]]
    """
    psi = theta.new_zeros(len(theta), 0) if psi is None else psi
    if h.device.type == "cpu" and HAS_COMPILER:
        return cast(Tensor, _WeightedSum.apply(h, basis, theta, psi, scale))
    total = torch.zeros_like(h[..., 0])
    for i in range(len(theta)):
        w = torch.zeros_like(total)
        for m in range(theta.shape[1]):
            w = w + theta[i, m] * basis[..., m]
        if psi.shape[1] > 0:
            w = w + own_weight(list(psi[i]), psi.shape[1], h[..., i] / scale, 0)  # type: ignore[arg-type]
        total = total + w * h[..., i]
    return total


def weight(theta: list[float], basis: list[float], i: int) -> float:
    """Return Σ_m θ_im φ_m; `theta` is flat, play by play. The kernel and the streams compile this."""
    w = 0.0
    for m in range(len(basis)):
        w += theta[i * len(basis) + m] * basis[m]
    return w


def own_weight(psi: list[float], degree: int, z: float, i: int) -> float:
    """Return Σ_q ψ_iq z^q by Horner's rule, q = 1 … `degree`; `psi` is flat, play by play."""
    w = 0.0
    for q in range(degree - 1, -1, -1):
        w = (w + psi[i * degree + q]) * z
    return w


class _WeightedSum(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, h: Tensor, basis: Tensor, theta: Tensor, psi: Tensor, scale: float) -> Tensor:
        h, basis, theta, psi = (part.detach().contiguous() for part in (h, basis, theta, psi))
        y = torch.empty(h.shape[:2], dtype=h.dtype)
        _forward(
            h.numpy(),
            basis.numpy(),
            theta.flatten().numpy(),
            psi.flatten().numpy(),
            psi.shape[1],
            scale,
            y.numpy(),
        )
        ctx.scale = scale
        ctx.save_for_backward(h, basis, theta, psi)
        return y

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        h, basis, theta, psi = ctx.saved_tensors
        gy = gradients[0].contiguous()
        gh, gbasis = torch.empty_like(h), torch.empty_like(basis)
        gtheta, gpsi = torch.zeros_like(theta), torch.zeros_like(psi)
        _backward(
            h.numpy(), basis.numpy(), theta.numpy(), psi.numpy(), ctx.scale, gy.numpy(),
            gh.numpy(), gbasis.numpy(), gtheta.numpy(), gpsi.numpy(),
        )  # fmt: skip
        return gh, gbasis, gtheta, gpsi, None


_weight: Any = njit(weight)
_own_weight: Any = njit(own_weight)


@njit
def _forward(
    h: np.ndarray,
    basis: np.ndarray,
    theta: np.ndarray,
    psi: np.ndarray,
    degree: int,
    scale: float,
    y: np.ndarray,
) -> None:
    for batch in range(h.shape[0]):
        for t in range(h.shape[1]):
            total = 0.0
            for i in range(h.shape[2]):
                w = _weight(theta, basis[batch, t], i)
                if degree > 0:
                    w += _own_weight(psi, degree, h[batch, t, i] / scale, i)
                total += w * h[batch, t, i]
            y[batch, t] = total


@njit
def _backward(
    h: np.ndarray, basis: np.ndarray, theta: np.ndarray, psi: np.ndarray, scale: float, gy: np.ndarray,
    gh: np.ndarray, gbasis: np.ndarray, gtheta: np.ndarray, gpsi: np.ndarray,
) -> None:  # fmt: skip
    for batch in range(h.shape[0]):
        for t in range(h.shape[1]):
            g = gy[batch, t]
            for m in range(basis.shape[2]):
                gbasis[batch, t, m] = 0
            for i in range(h.shape[2]):
                slope = 0.0
                gw = g * h[batch, t, i]
                for m in range(basis.shape[2]):
                    slope += theta[i, m] * basis[batch, t, m]
                    gbasis[batch, t, m] += theta[i, m] * gw
                    gtheta[i, m] += basis[batch, t, m] * gw
                z = h[batch, t, i] / scale
                power = z
                for q in range(psi.shape[1]):
                    # d(ψ z^(q+1) h)/dh = (q + 2) ψ z^(q+1)
                    slope += (q + 2) * psi[i, q] * power
                    gpsi[i, q] += power * gw
                    power *= z
                gh[batch, t, i] = slope * g
