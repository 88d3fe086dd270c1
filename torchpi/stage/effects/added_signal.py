"""Effects that add a signal in absolute time: y = x + s(t; a, b, c), t from the first sample."""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from torchpi.stage.effects.effect import Effect

Signal = Callable[[float, float, float, float], float]


def sampled(
    kernel: Any,  # compiled: (elapsed (batch,), period, *parameters, s (batch, time)) fills in s
    of_tensors: Callable[..., Tensor],  # s(t, *parameters)
    elapsed: Tensor,  # (batch, 1), samples before the first of these
    time: int,
    period_s: float,
    parameters: Sequence[Tensor],  # () each
) -> Tensor:  # (batch, time)
    """A signal at `time` samples; differentiable in the state and in all parameters."""
    return _Sampled.apply(kernel, of_tensors, time, period_s, elapsed, *parameters)  # type: ignore


class AddedSignal(Effect):
    """A signal of three parameters, the first of `quantities`. The state: samples since the first.

    The scalar equation serves kernel and stream, whose bits agree; the one of tensors only the gradients.
    """

    signal: ClassVar[Any]
    """s(t), of floats."""
    kernel: ClassVar[Any]
    """Compiled: (elapsed (batch,), period, a, b, c, s (batch, time)) fills in s."""
    of_tensors: ClassVar[Any]
    """s(t), of tensors."""

    def initial_state(self, batch: int) -> Tensor:
        return torch.zeros(batch, 1, dtype=torch.float64)

    def forward(
        self,
        x: Tensor,  # (batch, time), µm
        state: Tensor | None = None,  # (batch, 1), samples
    ) -> tuple[Tensor, Tensor]:
        elapsed = self.initial_state(len(x)) if state is None else state
        time, period_s = x.shape[1], self.sample_period_s
        added = sampled(self.kernel, self.of_tensors, elapsed, time, period_s, self._parameters_of_signal())
        return x + added.to(x), elapsed + time

    def stream(self) -> nn.Module:
        a, b, c = (parameter.item() for parameter in self._parameters_of_signal())
        return AddedSignalStream(self.signal, self.sample_period_s, a, b, c)

    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        return dx

    def _parameters_of_signal(self) -> list[Tensor]:
        return [getattr(self, name) for name in list(self.quantities)[:3]]


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
