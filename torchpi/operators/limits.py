"""Limiting a voltage to its range: max{low, min{high, u}}, with corners that may be rounded.

The rounded corner is the smooth maximum of Chen and Mangasarian (*Mathematical Programming* 71, 1995),

    max{x, a} → a + K ln(1 + e^{(x - a)/K}),

whose slope at the limit is one half, and which departs from the sharp corner by at most K ln 2.
"""

import math
from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable


def clip(x: float, low: float, high: float, knee: float = 0.0) -> float:
    """Return max{low, min{high, x}}, with corners of width `knee`."""
    below = min(high, x)
    if knee > 0.0:
        below -= knee * math.log1p(math.exp(-abs(x - high) / knee))
        return max(low, below) + knee * math.log1p(math.exp(-abs(below - low) / knee))
    return max(low, below)


def clip_step(x: float, n: list[float], s: list[float]) -> float:
    """`clip` in the form a stream calls: n holds both ends and the knee."""
    return clip(x, n[0], n[1], n[2])


def clipped(
    x: Tensor,  # (batch, time)
    low: Tensor,
    high: Tensor,
    knee: Tensor,
) -> Tensor:  # (batch, time)
    """Apply `clip` to every sample, differentiable in all four arguments."""
    y: Tensor = _Clip.apply(x, low, high, knee)
    return y


def clip_slope(x: np.ndarray, low: float, high: float, knee: float) -> np.ndarray:
    """Return the derivative, (time,), of `clip` with respect to x, (time,)."""
    by_x: np.ndarray = _slopes(x, low, high, knee)[0]
    return by_x


class _Clip(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, low: Tensor, high: Tensor, knee: Tensor) -> Tensor:
        flat = x.detach().contiguous().reshape(-1)
        ctx.save_for_backward(flat, low, high, knee)
        v = torch.empty_like(flat)
        _fill(flat.numpy(), low.item(), high.item(), knee.item(), v.numpy())
        return v.reshape(x.shape)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, ...]:
        x, low, high, knee = ctx.saved_tensors
        slopes = _slopes(x.numpy(), low.item(), high.item(), knee.item())
        by_x, *of_numbers = (torch.from_numpy(part) for part in slopes)
        g = gradients[0]
        return (by_x.reshape(g.shape) * g, *((part * g.reshape(-1)).sum() for part in of_numbers))


_clip: Any = numba.njit(clip)


@numba.njit(cache=True)
def _fill(x: np.ndarray, low: float, high: float, knee: float, v: np.ndarray) -> None:
    for t in range(len(x)):
        v[t] = _clip(x[t], low, high, knee)


def _slopes(x: np.ndarray, low: float, high: float, knee: float) -> tuple[np.ndarray, ...]:
    """Return the derivatives of `clip` with respect to x, low, high and the knee, (time,) each."""
    if knee == 0.0:
        inside = (x >= low) & (x <= high)
        return inside.astype(float), (x < low).astype(float), (x > high).astype(float), np.zeros(len(x))
    above, of_high = _corner(x - high, knee)
    below = np.minimum(x, high) - of_high[0]
    under, of_low = _corner(low - below, knee)
    by_below = 1.0 - under
    return (
        by_below * (1.0 - above),
        under,
        by_below * above,
        of_low[1] - by_below * of_high[1],
    )


def _corner(beyond: np.ndarray, knee: float) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Return the weight of a limit in the slope, (time,), at the distance `beyond` it, and the rounding of
    the corner with its derivative with respect to the knee."""
    z = np.abs(beyond) / knee
    e = np.exp(-z)
    share = np.where(beyond > 0, 1.0, e) / (1.0 + e)
    far = np.isinf(z)
    rounded = np.log1p(e)
    return share, (knee * rounded, rounded + np.where(far, 0.0, z) * e / (1.0 + e))
