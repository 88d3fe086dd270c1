"""A mains line in the reading: y = x + a cos 2πft + b sin 2πft, t from the first sample."""

import math
from typing import Any, ClassVar

import numba
import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from torchpi.operators.quantity import Quantity
from torchpi.stage.effects.effect import Effect, Parameters, Seen

MAINS_HZ = (50.0, 60.0, 100.0, 120.0, 150.0, 180.0)


def hum(elapsed: float, period_s: float, frequency_hz: float, cos_um: float, sin_um: float) -> float:
    """a cos φ + b sin φ, φ = 2πft, at `elapsed` samples from the first. Kernel and stream compile this."""
    phase = 2.0 * math.pi * frequency_hz * (elapsed * period_s)
    return cos_um * math.cos(phase) + sin_um * math.sin(phase)


class Hum(Effect):
    """One line of the mains, or of a multiple of it; its phase is another one in each recording.

    The state is the number of samples since the first.
    """

    name = "hum"
    block = "sensor"
    equation = "y = x + a cos 2πft + b sin 2πft"
    signature = "one exact line, not periodic with the input, of one size in motion and at rest"
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
        line = _Hum.apply(
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
        y = x + hum(self.elapsed, self.period_s, self.frequency_hz, self.cos_um, self.sin_um)
        self.elapsed += 1.0
        return y


class _Hum(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        elapsed: Tensor,
        time: int,
        period_s: float,
        frequency_hz: Tensor,
        cos_um: Tensor,
        sin_um: Tensor,
    ) -> Tensor:  # (batch, time)
        line = elapsed.new_empty(len(elapsed), time)
        _line(
            elapsed.detach()[:, 0].numpy(),
            period_s,
            frequency_hz.item(),
            cos_um.item(),
            sin_um.item(),
            line.numpy(),
        )
        ctx.period_s, ctx.time = period_s, time
        ctx.save_for_backward(elapsed, frequency_hz, cos_um, sin_um)
        return line

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        elapsed, frequency_hz, cos_um, sin_um = ctx.saved_tensors
        t = (elapsed + torch.arange(ctx.time, dtype=torch.float64)) * ctx.period_s
        phase = 2 * math.pi * frequency_hz * t
        cosine, sine = torch.cos(phase), torch.sin(phase)
        by_phase = gradients[0] * (sin_um * cosine - cos_um * sine)
        by_t = 2 * math.pi * frequency_hz * by_phase
        return (
            (by_t * ctx.period_s).sum(1, keepdim=True),
            None,
            None,
            (by_phase * 2 * math.pi * t).sum(),
            (gradients[0] * cosine).sum(),
            (gradients[0] * sine).sum(),
        )


_hum: Any = numba.njit(hum)


@numba.njit(cache=True)
def _line(
    elapsed: np.ndarray, period_s: float, frequency_hz: float, cos_um: float, sin_um: float, line: np.ndarray
) -> None:
    for batch in range(line.shape[0]):
        for k in range(line.shape[1]):
            line[batch, k] = _hum(elapsed[batch] + k, period_s, frequency_hz, cos_um, sin_um)
