"""A line in absolute time, a cos 2πft + b sin 2πft, t from the first sample, whatever the stage does."""

import math
from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable


def oscillation(elapsed: float, period_s: float, frequency_hz: float, cos: float, sin: float) -> float:
    """a cos φ + b sin φ, φ = 2πft, at `elapsed` samples from the first. Kernel and streams compile this."""
    phase = 2.0 * math.pi * frequency_hz * (elapsed * period_s)
    return cos * math.cos(phase) + sin * math.sin(phase)


def oscillations(
    elapsed: Tensor,  # (batch, 1), samples before the first of these
    time: int,
    period_s: float,
    frequency_hz: Tensor,  # ()
    cos: Tensor,  # ()
    sin: Tensor,  # ()
) -> Tensor:  # (batch, time)
    """The line at `time` samples; differentiable in the state and in all three parameters."""
    return _Oscillation.apply(elapsed, time, period_s, frequency_hz, cos, sin)  # type: ignore[no-any-return]


class _Oscillation(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, elapsed: Tensor, time: int, period_s: float, frequency_hz: Tensor, cos: Tensor, sin: Tensor
    ) -> Tensor:
        line = elapsed.new_empty(len(elapsed), time)
        _line(
            elapsed.detach()[:, 0].numpy(),
            period_s,
            frequency_hz.item(),
            cos.item(),
            sin.item(),
            line.numpy(),
        )
        ctx.period_s, ctx.time = period_s, time
        ctx.save_for_backward(elapsed, frequency_hz, cos, sin)
        return line

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        elapsed, frequency_hz, cos, sin = ctx.saved_tensors
        t = (elapsed + torch.arange(ctx.time, dtype=torch.float64)) * ctx.period_s
        phase = 2 * math.pi * frequency_hz * t
        cosine, sine = torch.cos(phase), torch.sin(phase)
        by_phase = gradients[0] * (sin * cosine - cos * sine)
        by_t = 2 * math.pi * frequency_hz * by_phase
        return (
            (by_t * ctx.period_s).sum(1, keepdim=True),
            None,
            None,
            (by_phase * 2 * math.pi * t).sum(),
            (gradients[0] * cosine).sum(),
            (gradients[0] * sine).sum(),
        )


_oscillation: Any = numba.njit(oscillation)


@numba.njit(cache=True)
def _line(
    elapsed: np.ndarray, period_s: float, frequency_hz: float, cos: float, sin: float, line: np.ndarray
) -> None:
    for batch in range(line.shape[0]):
        for k in range(line.shape[1]):
            line[batch, k] = _oscillation(elapsed[batch] + k, period_s, frequency_hz, cos, sin)
