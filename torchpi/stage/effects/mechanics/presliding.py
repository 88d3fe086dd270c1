"""Friction with presliding behind a spring: a play with rounded corners.

Dahl, *A solid friction model*, Aerospace Corporation TOR-0158(3107-18)-1, 1968: the friction force F of a
displacement y obeys dF/dy = σ [1 - (F/F_c) sgn(dy)]. Behind a spring k, which loses d = F/k of the motion x,

    y = x - d,    dd/dy = (r/ρ) [1 - (d/r) sgn(dy)],    r = F_c/k, ρ = F_c/σ

A straight move of Δx = s a from (x, y) has a closed form in one unknown, b = |Δy|, with c = r - s d:

    b + c (1 - e^{-b/ρ}) = a,    d⁺ = s (r - c e^{-b/ρ})

ρ → 0 is the play of threshold r (Coulomb friction, Prandtl).
"""

import math
from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable


def slide(x: float, before: float, y: float, r: float, rho: float) -> float:
    """Return y after a straight move of the input from `before` to x. Kernels and stream compile this."""
    if rho <= 1e-6 * r:  # no corner that anyone could measure
        return max(x - r, min(x + r, y))
    side = 1.0 if x > before else -1.0
    a = abs(x - before)
    c = max(0.0, r - side * (before - y))
    # The left side is concave in b, and the start is below the root, so Newton's steps only rise towards it.
    b = max(a - c, a * rho / (rho + c))
    for _ in range(60):
        gone = -math.expm1(-b / rho)
        step = (a - b - c * gone) / (1.0 + c / rho * (1.0 - gone))
        b = b + step
        if step <= 1e-15 * a:
            break
    return x - side * (r - c * math.exp(-b / rho))


def slide_step(x: float, n: list[float], s: list[float]) -> float:
    """`slide` as the step of a stream; n holds r and ρ, s holds y and x of the sample before."""
    s[0] = slide(x, s[1], s[0], n[0], n[1])
    s[1] = x
    return s[0]


class Slide(torch.autograd.Function):
    """`slide` over whole records; the state is y and x of the sample before."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, r: Tensor, rho: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        x = x.detach().contiguous()
        y, after = torch.empty_like(x), state.detach().clone()
        _forward(x.numpy(), r.item(), rho.item(), after.numpy(), y.numpy())
        ctx.save_for_backward(x, r, rho, state, y)
        return y, after

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, ...]:
        x, r, rho, state, y = ctx.saved_tensors
        gx, gstate = torch.zeros_like(x), gradients[1].clone()
        gr, grho = _backward(
            x.numpy(),
            r.item(),
            rho.item(),
            state.detach().numpy(),
            y.numpy(),
            gradients[0].contiguous().numpy(),
            gx.numpy(),
            gstate.numpy(),
        )
        return gx, torch.tensor(gr, dtype=r.dtype), torch.tensor(grho, dtype=rho.dtype), gstate


def slide_tangent(
    x: Tensor,  # (1, time)
    dx: Tensor,  # (directions, time)
    r: float,
    rho: float,
) -> Tensor:  # (directions, time)
    """Return the derivative of y along each direction of x, from rest at 0."""
    dx = dx.detach().contiguous()
    dy = torch.empty_like(dx)
    _tangent(x[0].detach().numpy(), dx.numpy(), r, rho, dy.numpy())
    return dy


_slide: Any = numba.njit(slide)


@numba.njit(cache=True)
def _slopes(
    x: float, before: float, y: float, r: float, rho: float
) -> tuple[float, float, float, float, float]:
    """Return the derivatives of `slide`, in the order of its arguments."""
    side = 1.0 if x > before else -1.0
    after = _slide(x, before, y, r, rho)
    if rho <= 1e-6 * r:
        return (0.0, 0.0, 1.0, 0.0, 0.0) if after == y else (1.0, 0.0, 0.0, -side, 0.0)
    c, b = max(0.0, r - side * (before - y)), abs(after - y)
    left = math.exp(-b / rho)
    by_a = 1.0 / (1.0 + c / rho * left)
    by_c = -(1.0 - left) * by_a
    return by_a, -by_a - by_c, 1.0 + by_c, side * by_c, side * c * b * left / rho**2 * by_a


@numba.njit(cache=True)
def _forward(x: np.ndarray, r: float, rho: float, state: np.ndarray, y: np.ndarray) -> None:
    for batch in range(x.shape[0]):
        now, before = state[batch, 0], state[batch, 1]
        for t in range(x.shape[1]):
            now = _slide(x[batch, t], before, now, r, rho)
            before = x[batch, t]
            y[batch, t] = now
        state[batch, 0], state[batch, 1] = now, before


@numba.njit(cache=True)
def _backward(
    x: np.ndarray,
    r: float,
    rho: float,
    state: np.ndarray,
    y: np.ndarray,
    gy: np.ndarray,
    gx: np.ndarray,
    gstate: np.ndarray,
) -> tuple[float, float]:
    gr, grho = 0.0, 0.0
    for batch in range(x.shape[0]):
        carried, by_last = gstate[batch, 0], gstate[batch, 1]
        for t in range(x.shape[1] - 1, -1, -1):
            carried += gy[batch, t]
            before = x[batch, t - 1] if t > 0 else state[batch, 1]
            last = y[batch, t - 1] if t > 0 else state[batch, 0]
            by_x, by_before, by_y, by_r, by_rho = _slopes(x[batch, t], before, last, r, rho)
            gx[batch, t] = by_last + carried * by_x
            by_last = carried * by_before
            gr += carried * by_r
            grho += carried * by_rho
            carried = carried * by_y
        gstate[batch, 0], gstate[batch, 1] = carried, by_last
    return gr, grho


@numba.njit(cache=True)
def _tangent(x: np.ndarray, dx: np.ndarray, r: float, rho: float, dy: np.ndarray) -> None:
    slopes = np.empty((len(x), 3))
    before, y = 0.0, 0.0
    for t in range(len(x)):
        slopes[t, 0], slopes[t, 1], slopes[t, 2], _, _ = _slopes(x[t], before, y, r, rho)
        y = _slide(x[t], before, y, r, rho)
        before = x[t]
    for row in range(len(dx)):
        moved, moved_before = 0.0, 0.0
        for t in range(len(x)):
            moved = slopes[t, 0] * dx[row, t] + slopes[t, 1] * moved_before + slopes[t, 2] * moved
            moved_before = dx[row, t]
            dy[row, t] = moved
