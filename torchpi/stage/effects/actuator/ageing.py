"""A gain that falls with time, or with travel: y = x e^{-(λt + μs)}, s = ∫|dx|, both from the first sample.

Depoling under drive goes with the cycles that the ceramic has made (Lupascu and Rödel, *Fatigue in bulk lead
zirconate titanate actuator materials*, 2005); ageing after poling goes with time.
"""

import math
from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from torchpi.operators.base import StepStream
from torchpi.stage.effects.effect import DataRange, Effect, Parameters, parameter


def travelled(travel_mm: float, x: float, before: float) -> float:
    """s after the move from `before` to `x`, µm. This and `aged` are what kernels and stream compile."""
    return travel_mm + 1e-3 * abs(x - before)


def aged(x: float, t_s: float, travel_mm: float, loss_per_s: float, loss_per_mm: float) -> float:
    """x e^{-(λt + μs)}."""
    return x * math.exp(-(loss_per_s * t_s + loss_per_mm * travel_mm))


def age_step(x: float, n: list[float], s: list[float]) -> float:
    """Both as a stream takes them: n holds T, λ and μ, s the state of `Ageing`."""
    s[1] = travelled(s[1], x, s[2])
    y = aged(x, s[0] * n[0], s[1], n[1], n[2])
    s[0] += 1.0
    s[2] = x
    return y


class Ageing(Effect):
    """A slow loss of gain. The state: samples since the first, travel in mm, the last input in µm.

    The de-energised actuator stands at 0: a first sample elsewhere has travelled that far.
    """

    name = "ageing"
    block = "actuator"
    equation = "y = x e^{-(λt + μs)}, s = ∫|dx|"
    signature = "the same move becomes smaller, in proportion to its size, as time or travel adds up"
    time_scale = "slow"
    degenerate_with = ("gain_modulation",)
    loss_per_s: nn.Parameter = parameter("1/s", at_least=0, at_most=10)
    loss_per_mm: nn.Parameter = parameter("1/mm", at_least=0, at_most=1e6)
    state_size = 3

    def forward(
        self,
        x: Tensor,  # (batch, time), µm
        state: Tensor | None = None,  # (batch, 3): samples, mm, µm
    ) -> tuple[Tensor, Tensor]:
        before = self.initial_state(len(x)) if state is None else state
        y, after = _Ageing.apply(
            x.to("cpu", torch.float64), before, self.sample_period_s, self.loss_per_s, self.loss_per_mm
        )
        return y.to(x), after

    def stream(self) -> nn.Module:
        numbers = [self.sample_period_s, self.loss_per_s.item(), self.loss_per_mm.item()]
        return StepStream(age_step, numbers, 3)

    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        """Exact: δy = (δx - μ x δs) e^{-(λt + μs)}; δs sums ±Δδx by the direction of each move."""
        x, dx = x.detach().contiguous(), dx.detach().contiguous()
        moved = torch.empty_like(dx)
        losses = (self.loss_per_s.item(), self.loss_per_mm.item())
        _tangent(x.numpy(), dx.numpy(), self.sample_period_s, *losses, moved.numpy())
        return moved

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        if seen.span_um == 0 or seen.span_v == 0:
            return []
        # In the mean a stage goes perhaps a quarter as fast as at most; it travels one span at least.
        fastest_um_s = seen.max_rate_v_s * seen.span_um / seen.span_v
        travel_mm = 1e-3 * max(fastest_um_s / 4 * seen.duration_s, seen.span_um)
        return [{"loss_per_s": 0.01 / seen.duration_s}, {"loss_per_mm": 0.01 / travel_mm}]


class _Ageing(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, x: Tensor, before: Tensor, period_s: float, loss_per_s: Tensor, loss_per_mm: Tensor
    ) -> tuple[Tensor, Tensor]:
        x = x.detach().contiguous()
        y, travel, after = torch.empty_like(x), torch.empty_like(x), before.clone()
        arrays = (part.numpy() for part in (after, travel, y))
        _forward(x.numpy(), period_s, loss_per_s.item(), loss_per_mm.item(), *arrays)
        ctx.period_s = period_s
        ctx.save_for_backward(x, before, travel, y, loss_per_s, loss_per_mm)
        return y, after

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        x, before, travel, y, loss_per_s, loss_per_mm = ctx.saved_tensors
        by_y, by_after = gradients
        t = (before[:, :1] + torch.arange(x.shape[1], dtype=torch.float64)) * ctx.period_s
        by_loss = -by_y * y
        # Travel at one sample is part of the travel at all later ones.
        ahead = (loss_per_mm * by_loss).flip(1).cumsum(1).flip(1) + by_after[:, 1:2]
        by_move = ahead * 1e-3 * torch.sign(torch.diff(x, dim=1, prepend=before[:, 2:]))
        by_x = by_y * torch.exp(-(loss_per_s * t + loss_per_mm * travel)) + by_move
        by_x[:, :-1] -= by_move[:, 1:]
        by_x[:, -1] += by_after[:, 2]
        by_elapsed = loss_per_s * ctx.period_s * by_loss.sum(1) + by_after[:, 0]
        by_before = torch.stack([by_elapsed, ahead[:, 0], -by_move[:, 0]], 1)
        return by_x, by_before, None, (by_loss * t).sum(), (by_loss * travel).sum()


_travelled: Any = numba.njit(travelled)
_aged: Any = numba.njit(aged)


@numba.njit(cache=True)
def _forward(
    x: np.ndarray,
    period_s: float,
    loss_per_s: float,
    loss_per_mm: float,
    state: np.ndarray,
    travel: np.ndarray,
    y: np.ndarray,
) -> None:
    for batch in range(x.shape[0]):
        elapsed, travel_mm, before = state[batch, 0], state[batch, 1], state[batch, 2]
        for k in range(x.shape[1]):
            travel_mm = _travelled(travel_mm, x[batch, k], before)
            travel[batch, k] = travel_mm
            y[batch, k] = _aged(x[batch, k], elapsed * period_s, travel_mm, loss_per_s, loss_per_mm)
            elapsed += 1.0
            before = x[batch, k]
        state[batch, 0], state[batch, 1], state[batch, 2] = elapsed, travel_mm, before


@numba.njit(cache=True)
def _tangent(
    x: np.ndarray, dx: np.ndarray, period_s: float, loss_per_s: float, loss_per_mm: float, moved: np.ndarray
) -> None:
    left, sign = np.empty(x.shape[1]), np.empty(x.shape[1])
    for row in range(dx.shape[0]):
        batch = row if x.shape[0] > 1 else 0
        if row == 0 or x.shape[0] > 1:
            travel_mm, before = 0.0, 0.0
            for k in range(x.shape[1]):
                travel_mm = _travelled(travel_mm, x[batch, k], before)
                left[k] = _aged(1.0, k * period_s, travel_mm, loss_per_s, loss_per_mm)
                sign[k] = np.sign(x[batch, k] - before)
                before = x[batch, k]
        lost, last = 0.0, 0.0
        for k in range(x.shape[1]):
            lost += 1e-3 * loss_per_mm * sign[k] * (dx[row, k] - last)
            last = dx[row, k]
            moved[row, k] = left[k] * (dx[row, k] - x[batch, k] * lost)
