"""The interface that every operator implements."""

from collections.abc import Callable, Sequence
from typing import ClassVar

import torch
from torch import Tensor, nn

from torchpi.errors import ConfigError


class Operator(nn.Module):
    """A causal map of one sampled signal to another, its state explicit.

    One equation serves three uses: `forward` maps whole records and carries gradients, `stream` returns a
    module that takes one sample at a time, and exports are made from that module. In float64 all three
    agree bit for bit, and a record processed in windows, with the state carried over, gives the same bits
    as the record in one piece. `torchpi.operators.conformance` tests this.
    """

    state_size: ClassVar[int] = 0
    """Number of states per row, unless `initial_state` is overridden."""

    def initial_state(self, batch: int) -> Tensor:
        """Return the state of the de-energised operator. Shape: (batch, states)."""
        return torch.zeros(batch, self.state_size, dtype=torch.float64)

    def forward(
        self,
        x: Tensor,  # (batch, time)
        state: Tensor | None = None,  # (batch, states); None is the de-energised state
    ) -> tuple[Tensor, Tensor]:
        """Return the output, (batch, time), and the state after the last sample."""
        raise TypeError(f"{type(self).__name__} must define forward(x, state)")

    def stream(self) -> nn.Module:
        """Return a scriptable module on plain floats with `reset()` and `step(x: float) -> float`."""
        raise TypeError(f"{type(self).__name__} must define stream()")


def check_records(x: object, name: str = "x") -> None:
    """Check that an argument is a floating-point tensor of shape (batch, time).

    Raises:
        ConfigError: It is not; the message begins with the argument's name.
    """
    if not isinstance(x, Tensor):
        raise ConfigError(f"{name}: found {type(x).__name__}, expected a tensor (batch, time)")
    if x.ndim != 2:
        raise ConfigError(f"{name}: found shape {tuple(x.shape)}, expected (batch, time)")
    if not x.is_floating_point():
        raise ConfigError(f"{name}: found {x.dtype}, expected floating-point numbers: x.double() has them")


class Static(Operator):
    """An operator without memory, which `of` defines."""

    def of(self, x: Tensor) -> Tensor:
        """Return the output, (batch, time)."""
        raise TypeError(f"{type(self).__name__} must define of(x)")

    def forward(self, x: Tensor, state: Tensor | None = None) -> tuple[Tensor, Tensor]:
        check_records(x)
        return self.of(x), self.initial_state(len(x)) if state is None else state


class StaticStream(nn.Module):
    """The same one sample at a time: nothing to reset."""

    @torch.jit.export
    def reset(self) -> None:
        return


Step = Callable[[float, list[float], list[float]], float]
"""Scalar function y(x, numbers, state) that updates the list `state` in place."""


class StepStream(nn.Module):
    """A scalar function, one sample at a time.

    Args:
        of: A plain function, which TorchScript compiles.
        numbers: Its parameters.
        states: Number of states, all 0 at rest.
    """

    numbers: list[float]
    state: list[float]

    def __init__(self, of: Step, numbers: Sequence[float], states: int = 0) -> None:
        super().__init__()
        self.of = of
        self.numbers = [float(number) for number in numbers]
        self.state = [0.0] * states

    @torch.jit.export
    def reset(self) -> None:
        for i in range(len(self.state)):
            self.state[i] = 0.0

    @torch.jit.export
    def step(self, x: float) -> float:
        return self.of(x, self.numbers, self.state)
