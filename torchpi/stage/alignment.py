"""The two ends of a stage's chain: the alignment of the command, and the zero of the reading."""

import torch
from torch import Tensor, nn

from torchpi.operators.base import Operator, Static, StepStream
from torchpi.operators.delay import delay_stream


class OneSampleLate(Operator):
    """Alignment 1: the command of the tick before. Before the first it is 0 V."""

    state_size = 1

    def forward(
        self,
        x: Tensor,  # (batch, time), V
        state: Tensor | None = None,  # (batch, 1), V
    ) -> tuple[Tensor, Tensor]:
        held = self.initial_state(len(x)).to(x.device) if state is None else state
        both = torch.cat([held.to(x.dtype), x], 1)
        return both[:, :-1], both[:, -1:].to(held.dtype)

    def stream(self) -> nn.Module:
        return delay_stream(1, 1.0, 0.0)


class OneSampleEarly(Static):
    """Alignment -1, behind a simulation of whole records: the last output is held."""

    def of(self, x: Tensor) -> Tensor:
        return torch.cat([x[:, 1:], x[:, -1:]], 1)


class Zero(Static):
    """The zero of the sensor, behind everything that has memory: a constant has no transient."""

    def __init__(self, zero_um: float) -> None:
        super().__init__()
        self.zero_um = float(zero_um)

    def of(self, x: Tensor) -> Tensor:
        return x + self.zero_um

    def stream(self) -> nn.Module:
        return StepStream(zero_step, [self.zero_um])


def zero_step(x: float, n: list[float], s: list[float]) -> float:
    """`Zero` as the step of a stream."""
    return x + n[0]
