"""Effects that add a signal in absolute time: y = x + s(t; a, b, c), t from the first sample."""

from collections.abc import Callable
from typing import Any, ClassVar

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from torchpi.stage.effects.effect import Effect

Signal = Callable[[float, float, float, float], float]


class AddedSignal(Effect):
    """A signal of three parameters, in the order of `quantities`. The state: samples since the first.

    The scalar equation serves kernel and stream, whose bits agree; the one of tensors only the gradients.
    """

    signal: ClassVar[Any]
    """s(t), of floats."""
    kernel: ClassVar[Any]
    """Compiled: (elapsed (batch,), period, a, b, c, s (batch, time)) fills in s."""

    @staticmethod
    def of_tensors(t_s: Tensor, a: Tensor, b: Tensor, c: Tensor) -> Tensor:
        """s(t), of tensors."""
        raise TypeError("an AddedSignal must define of_tensors(t_s, a, b, c)")

    def initial_state(self, batch: int) -> Tensor:
        return torch.zeros(batch, 1, dtype=torch.float64)

    def forward(
        self,
        x: Tensor,  # (batch, time), µm
        state: Tensor | None = None,  # (batch, 1), samples
    ) -> tuple[Tensor, Tensor]:
        elapsed = self.initial_state(len(x)) if state is None else state
        parameters = [getattr(self, name) for name in self.quantities]
        added = _Added.apply(type(self), x.shape[1], self.sample_period_s, elapsed, *parameters)  # type: ignore[no-untyped-call]
        return x + added.to(x), elapsed + x.shape[1]

    def stream(self) -> nn.Module:
        return AddedSignalStream(self.signal, self.sample_period_s, *self.values().values())

    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        return dx


class AddedSignalStream(nn.Module):
    """The signal, one sample at a time."""

    def __init__(self, signal: Signal, period_s: float, a: float, b: float, c: float) -> None:
        super().__init__()
        self.signal = signal
        self.period_s = period_s
        self.a = a
        self.b = b
        self.c = c
        self.elapsed = 0.0

    @torch.jit.export
    def reset(self) -> None:
        self.elapsed = 0.0

    @torch.jit.export
    def step(self, x: float) -> float:
        y = x + self.signal(self.elapsed * self.period_s, self.a, self.b, self.c)
        self.elapsed += 1.0
        return y


class _Added(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, kind: type[AddedSignal], time: int, period_s: float, elapsed: Tensor, *parameters: Tensor
    ) -> Tensor:  # (batch, time)
        added = elapsed.new_empty(len(elapsed), time)
        numbers = (parameter.item() for parameter in parameters)
        kind.kernel(elapsed.detach()[:, 0].numpy(), period_s, *numbers, added.numpy())
        ctx.kind, ctx.time, ctx.period_s = kind, time, period_s
        ctx.save_for_backward(elapsed, *parameters)
        return added

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        with torch.enable_grad():
            elapsed, *parameters = (saved.detach().requires_grad_() for saved in ctx.saved_tensors)
            t_s = (elapsed + torch.arange(ctx.time, dtype=torch.float64)) * ctx.period_s
            added = ctx.kind.of_tensors(t_s, *parameters)
        return None, None, None, *torch.autograd.grad(added, [elapsed, *parameters], gradients[0])
