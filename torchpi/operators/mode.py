"""A mechanical mode: ẍ + 2ζω₀ẋ + ω₀²x = ω₀²x_in, with ω₀ = 2πf₀."""

import math
from typing import ClassVar

import torch

from torchpi.operators.linear import LinearBlock, Matrices
from torchpi.operators.quantity import Quantity


class Mode(LinearBlock):
    """One mode of unit static gain. Its input runs straight from sample to sample.

    Args:
        sample_period_s: T.
        frequency_hz: f₀, undamped.
        damping_ratio: ζ.

    Raises:
        StageError: A frequency that is not positive, or negative damping.
    """

    order = 2
    quantities: ClassVar[dict[str, Quantity]] = {
        "frequency_hz": Quantity("Hz", at_least=0, positive=True),
        "damping_ratio": Quantity("", at_least=0),
    }

    def __init__(self, sample_period_s: float, frequency_hz: float, damping_ratio: float) -> None:
        super().__init__(sample_period_s)
        self.frequency_hz = self.quantities["frequency_hz"].parameter("frequency_hz", frequency_hz)
        self.damping_ratio = self.quantities["damping_ratio"].parameter("damping_ratio", damping_ratio)

    def continuous(self) -> Matrices:
        omega = 2 * math.pi * self.frequency_hz
        zero, one = torch.zeros_like(omega), torch.ones_like(omega)
        # The second state is ẋ/ω₀: both are then of like size, which keeps the exponential accurate.
        a = torch.stack([zero, omega, -omega, -2 * self.damping_ratio * omega]).reshape(2, 2)
        return a, torch.stack([zero, omega]), torch.stack([one, zero]), zero

    def extra_repr(self) -> str:
        return f"{self.frequency_hz.item():g} Hz, damping ratio {self.damping_ratio.item():g}"
