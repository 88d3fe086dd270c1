"""A mains line in the reading: y = x + a cos 2πft + b sin 2πft, t from the first sample."""

from typing import ClassVar

import torch
from torch import Tensor, nn

from torchpi.operators.quantity import Quantity
from torchpi.stage.effects.effect import Effect, Parameters, Seen
from torchpi.stage.effects.oscillation import oscillation, oscillations

MAINS_HZ = (50.0, 60.0, 100.0, 120.0, 150.0, 180.0)


class Hum(Effect):
    """One line of the mains, or of a multiple of it; its phase is another one in each recording.

    The state is the number of samples since the first.
    """

    name = "hum"
    block = "sensor"
    equation = "y = x + a cos 2πft + b sin 2πft"
    signature = "one exact line, not periodic with the input, of one size in motion and at rest"
    unseen = "these recordings show no three periods of the mains"
    quantities: ClassVar[dict[str, Quantity]] = {
        "frequency_hz": Quantity("Hz", at_least=45, at_most=400),
        "cos_um": Quantity("µm", at_least=-1e3, at_most=1e3),
        "sin_um": Quantity("µm", at_least=-1e3, at_most=1e3),
    }
    identity: ClassVar[Parameters] = {"frequency_hz": 50.0, "cos_um": 0.0, "sin_um": 0.0}
    per_recording = ("cos_um", "sin_um")
    frequency_hz: nn.Parameter
    cos_um: nn.Parameter
    sin_um: nn.Parameter

    def initial_state(self, batch: int) -> Tensor:
        return torch.zeros(batch, 1, dtype=torch.float64)

    def forward(
        self,
        x: Tensor,  # (batch, time), µm
        state: Tensor | None = None,  # (batch, 1), samples
    ) -> tuple[Tensor, Tensor]:
        elapsed = self.initial_state(len(x)) if state is None else state
        line = oscillations(
            elapsed, x.shape[1], self.sample_period_s, self.frequency_hz, self.cos_um, self.sin_um
        )
        return x + line.to(x), elapsed + x.shape[1]

    def stream(self) -> nn.Module:
        return HumStream(
            self.sample_period_s, self.frequency_hz.item(), self.cos_um.item(), self.sin_um.item()
        )

    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        return dx

    @classmethod
    def starts(cls, seen: Seen) -> list[Parameters]:
        # Below a few periods a line is a drift; above half of the sample rate it shows as another one.
        size = 1e-3 * seen.span_um
        seen_lines = [f for f in MAINS_HZ if 3 / seen.duration_s < f < seen.fs_hz / 2 and size > 0]
        return [{"frequency_hz": f, "cos_um": size, "sin_um": size} for f in seen_lines]


class HumStream(nn.Module):
    """The line, one sample at a time."""

    def __init__(self, period_s: float, frequency_hz: float, cos_um: float, sin_um: float) -> None:
        super().__init__()
        self.period_s = period_s
        self.frequency_hz = frequency_hz
        self.cos_um = cos_um
        self.sin_um = sin_um
        self.elapsed = 0.0

    @torch.jit.export
    def reset(self) -> None:
        self.elapsed = 0.0

    @torch.jit.export
    def step(self, x: float) -> float:
        line = oscillation(self.elapsed, self.period_s, self.frequency_hz, self.cos_um, self.sin_um)
        self.elapsed += 1.0
        return x + line
