"""A gain that falls with time, or with travel: y = x e^{-((λt)^β + μs)}, s = ∫|dx|, from the first sample.

Depoling under drive depends on the cycles that the ceramic has made (Lupascu and Rödel, *Fatigue in bulk lead
zirconate titanate actuator materials*, 2005). Ageing after poling depends on time, fast at first (β < 1) like
many relaxations (Kohlrausch, *Annalen der Physik* 167, 1854), or ever faster (β > 1) like wear (Weibull,
*J. Applied Mechanics* 18, 1951).
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
    """Return s after a move from `before` to `x`, µm. Kernels and stream compile this and `aged`."""
    return travel_mm + 1e-3 * abs(x - before)


def aged(
    x: float, t_s: float, travel_mm: float, loss_per_s: float, loss_per_mm: float, exponent: float
) -> float:
    """Return x e^{-((λt)^β + μs)}."""
    lost = loss_per_s * t_s
    if exponent != 1.0 and lost > 0.0:
        lost = math.exp(exponent * math.log(lost))
    return x * math.exp(-(lost + loss_per_mm * travel_mm))


def age_step(x: float, n: list[float], s: list[float]) -> float:
    """Both as the step of a stream; n holds T, λ, μ and β, s the state of `Ageing`."""
    s[1] = travelled(s[1], x, s[2])
    y = aged(x, s[0] * n[0], s[1], n[1], n[2], n[3])
    s[0] += 1.0
    s[2] = x
    return y


class Ageing(Effect):
    """A slow loss of gain. The state: samples since the first, travel in mm, the last input in µm.

    The de-energised actuator is at 0, so the distance of the first sample from 0 counts as travel.
    """

    name = "ageing"
    block = "actuator"
    equation = "y = x e^{-((λt)^β + μs)}, s = ∫|dx|"
    signature = "the same move becomes smaller, in proportion to its size, as time or travel accumulates"
    time_scale = "slow"
    degenerate_with = ("gain_modulation",)
    loss_per_s: nn.Parameter = parameter("1/s", at_least=0, at_most=10)
    loss_per_mm: nn.Parameter = parameter("1/mm", at_least=0, at_most=1e6)
    exponent: nn.Parameter = parameter("", at_least=0.3, at_most=3, identity=1.0)
    state_size = 3

    def forward(
        self,
        x: Tensor,  # (batch, time), µm
        state: Tensor | None = None,  # (batch, 3): samples, mm, µm
    ) -> tuple[Tensor, Tensor]:
        before = self.initial_state(len(x)) if state is None else state
        y, after = _Ageing.apply(x.to("cpu", torch.float64), before, self.sample_period_s, *self.numbers())
        return y.to(x), after

    def numbers(self) -> tuple[nn.Parameter, ...]:
        """Return λ, μ and β."""
        return self.loss_per_s, self.loss_per_mm, self.exponent

    def stream(self) -> nn.Module:
        return StepStream(age_step, [self.sample_period_s, *(one.item() for one in self.numbers())], 3)

    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        """Exact: δy = (δx - μ x δs) e^{-((λt)^β + μs)}; δs sums Δδx with the sign of each move."""
        x, dx = x.detach().contiguous(), dx.detach().contiguous()
        moved = torch.empty_like(dx)
        loss_per_s, loss_per_mm, exponent = (one.item() for one in self.numbers())
        period_s = self.sample_period_s
        _tangent(x.numpy(), dx.numpy(), period_s, loss_per_s, loss_per_mm, exponent, moved.numpy())
        return moved

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        if seen.span_um == 0 or seen.span_v == 0:
            return []
        # The mean speed of a stage is perhaps a quarter of its largest; it travels at least one span.
        fastest_um_s = seen.max_rate_v_s * seen.span_um / seen.span_v
        travel_mm = 1e-3 * max(fastest_um_s / 4 * seen.duration_s, seen.span_um)
        by_time = {"loss_per_s": 0.01 / seen.duration_s}
        return [by_time, {**by_time, "exponent": 1.0}, {"loss_per_mm": 0.01 / travel_mm}]


class _Ageing(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, x: Tensor, before: Tensor, period_s: float, *numbers: Tensor
    ) -> tuple[Tensor, Tensor]:
        x = x.detach().contiguous()
        y, travel, after = torch.empty_like(x), torch.empty_like(x), before.clone()
        arrays = (part.numpy() for part in (after, travel, y))
        loss_per_s, loss_per_mm, exponent = (one.item() for one in numbers)
        _forward(x.numpy(), period_s, loss_per_s, loss_per_mm, exponent, *arrays)
        ctx.period_s = period_s
        ctx.save_for_backward(x, before, travel, y, *numbers)
        return y, after

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        x, before, travel, y, loss_per_s, loss_per_mm, exponent = ctx.saved_tensors
        by_y, by_after = gradients
        t = (before[:, :1] + torch.arange(x.shape[1], dtype=torch.float64)) * ctx.period_s
        by_loss = -by_y * y
        lost = loss_per_s * t
        under_way = lost > 0
        # β (λt)^{β-1}, the slope of the loss over λt; at λt = 0 it is taken as 1 for β = 1, otherwise as 0.
        log = torch.log(torch.where(under_way, lost, 1.0))
        grows = torch.where(under_way, exponent * torch.exp((exponent - 1) * log), (exponent == 1).to(x))
        # Travel at one sample is part of the travel at all later ones.
        ahead = (loss_per_mm * by_loss).flip(1).cumsum(1).flip(1) + by_after[:, 1:2]
        by_move = ahead * 1e-3 * torch.sign(torch.diff(x, dim=1, prepend=before[:, 2:]))
        lost = torch.where(under_way, torch.exp(exponent * log), 0.0)
        by_x = by_y * torch.exp(-(lost + loss_per_mm * travel)) + by_move
        by_x[:, :-1] -= by_move[:, 1:]
        by_x[:, -1] += by_after[:, 2]
        by_elapsed = loss_per_s * ctx.period_s * (by_loss * grows).sum(1) + by_after[:, 0]
        by_before = torch.stack([by_elapsed, ahead[:, 0], -by_move[:, 0]], 1)
        by_numbers = [(by_loss * each).sum() for each in (grows * t, travel, lost * log)]
        return by_x, by_before, None, *by_numbers


_travelled: Any = numba.njit(travelled)
_aged: Any = numba.njit(aged)


@numba.njit(cache=True)
def _forward(
    x: np.ndarray,
    period_s: float,
    loss_per_s: float,
    loss_per_mm: float,
    exponent: float,
    state: np.ndarray,
    travel: np.ndarray,
    y: np.ndarray,
) -> None:
    for batch in range(x.shape[0]):
        elapsed, travel_mm, before = state[batch, 0], state[batch, 1], state[batch, 2]
        for k in range(x.shape[1]):
            travel_mm = _travelled(travel_mm, x[batch, k], before)
            travel[batch, k] = travel_mm
            t_s = elapsed * period_s
            y[batch, k] = _aged(x[batch, k], t_s, travel_mm, loss_per_s, loss_per_mm, exponent)
            elapsed += 1.0
            before = x[batch, k]
        state[batch, 0], state[batch, 1], state[batch, 2] = elapsed, travel_mm, before


@numba.njit(cache=True)
def _tangent(
    x: np.ndarray,
    dx: np.ndarray,
    period_s: float,
    loss_per_s: float,
    loss_per_mm: float,
    exponent: float,
    moved: np.ndarray,
) -> None:
    left, sign = np.empty(x.shape[1]), np.empty(x.shape[1])
    for row in range(dx.shape[0]):
        batch = row if x.shape[0] > 1 else 0
        if row == 0 or x.shape[0] > 1:
            travel_mm, before = 0.0, 0.0
            for k in range(x.shape[1]):
                travel_mm = _travelled(travel_mm, x[batch, k], before)
                left[k] = _aged(1.0, k * period_s, travel_mm, loss_per_s, loss_per_mm, exponent)
                sign[k] = np.sign(x[batch, k] - before)
                before = x[batch, k]
        lost, last = 0.0, 0.0
        for k in range(x.shape[1]):
            lost += 1e-3 * loss_per_mm * sign[k] * (dx[row, k] - last)
            last = dx[row, k]
            moved[row, k] = left[k] * (dx[row, k] - x[batch, k] * lost)
