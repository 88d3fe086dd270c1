"""A mains line in the reading: y = x + a cos 2πft + b sin 2πft, t from the first sample."""

import math
from typing import Any, ClassVar

import numba
import numpy as np
import torch
from torch import Tensor, nn

from torchpi.operators.quantity import Quantity
from torchpi.stage.effects.added_signal import AddedSignal
from torchpi.stage.effects.effect import Parameters, Seen

MAINS_HZ = (50.0, 60.0, 100.0, 120.0, 150.0, 180.0)


def hum(t_s: float, frequency_hz: float, cos_um: float, sin_um: float) -> float:
    """a cos φ + b sin φ, φ = 2πft."""
    phase = 2.0 * math.pi * frequency_hz * t_s
    return cos_um * math.cos(phase) + sin_um * math.sin(phase)


_hum: Any = numba.njit(hum)


@numba.njit(cache=True)
def _line(
    elapsed: np.ndarray, period_s: float, frequency_hz: float, cos_um: float, sin_um: float, line: np.ndarray
) -> None:
    for batch in range(line.shape[0]):
        for k in range(line.shape[1]):
            line[batch, k] = _hum((elapsed[batch] + k) * period_s, frequency_hz, cos_um, sin_um)


class Hum(AddedSignal):
    """One line of the mains, or of a multiple of it; its phase is another one in each recording."""

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
    signal, kernel = staticmethod(hum), staticmethod(_line)
    frequency_hz: nn.Parameter
    cos_um: nn.Parameter
    sin_um: nn.Parameter

    @staticmethod
    def of_tensors(t_s: Tensor, a: Tensor, b: Tensor, c: Tensor) -> Tensor:
        phase = 2 * math.pi * a * t_s
        return b * torch.cos(phase) + c * torch.sin(phase)

    @classmethod
    def starts(cls, seen: Seen) -> list[Parameters]:
        # Below a few periods a line is a drift; above half of the sample rate it shows as another one.
        size = 1e-3 * seen.span_um
        seen_lines = [f for f in MAINS_HZ if 3 / seen.duration_s < f < seen.fs_hz / 2 and size > 0]
        return [{"frequency_hz": f, "cos_um": size, "sin_um": size} for f in seen_lines]
