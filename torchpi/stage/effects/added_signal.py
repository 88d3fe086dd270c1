"""Effects in absolute time, with t from the first sample; most add a signal, y = x + s(t)."""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from torchpi.stage.effects.effect import Effect


def sampled(
    kernel: Any,  # compiled: (elapsed (batch,), period, *parameters, s (batch, time)) fills in s
    of_tensors: Callable[..., Tensor],  # s(t, *parameters)
    elapsed: Tensor,  # (batch, 1), samples elapsed before the first one
    time: int,
    period_s: float,
    parameters: Sequence[Tensor],  # () each
) -> Tensor:  # (batch, time)
    """Return a signal at `time` samples, differentiable in the state and in all parameters."""
    return _Sampled.apply(kernel, of_tensors, time, period_s, elapsed, *parameters)  # type: ignore


class InTime(Effect):
    """What depends on the time. The state: samples since the first."""

    state_size = 1


class AddedSignal(InTime):
    """What adds a signal, whatever the stage does."""

    def forward(
        self,
        x: Tensor,  # (batch, time), µm
        state: Tensor | None = None,  # (batch, 1), samples
    ) -> tuple[Tensor, Tensor]:
        elapsed = self.initial_state(len(x)) if state is None else state
        return x + self.added(elapsed, x.shape[1]).to(x), elapsed + x.shape[1]

    def added(self, elapsed: Tensor, time: int) -> Tensor:
        """Return the signal, (batch, time), µm, that begins after `elapsed` samples, (batch, 1)."""
        raise NotImplementedError

    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        return dx


class _Sampled(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        kernel: Any,
        of_tensors: Any,
        time: int,
        period_s: float,
        elapsed: Tensor,
        *parameters: Tensor,
    ) -> Tensor:  # (batch, time)
        signal = elapsed.new_empty(len(elapsed), time)
        numbers = (parameter.item() for parameter in parameters)
        kernel(elapsed.detach()[:, 0].numpy(), period_s, *numbers, signal.numpy())
        ctx.of_tensors, ctx.time, ctx.period_s = of_tensors, time, period_s
        ctx.save_for_backward(elapsed, *parameters)
        return signal

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        with torch.enable_grad():
            elapsed, *parameters = (saved.detach().requires_grad_() for saved in ctx.saved_tensors)
            t_s = (elapsed + torch.arange(ctx.time, dtype=torch.float64)) * ctx.period_s
            signal = ctx.of_tensors(t_s, *parameters)
        return None, None, None, None, *torch.autograd.grad(signal, [elapsed, *parameters], gradients[0])
