"""The first-order lag v̇ = 2πf_c (u - v)."""

import math
from typing import ClassVar

import torch

from torchpi.operators.linear import LinearBlock, Matrices
from torchpi.operators.quantity import Quantity

CUTOFF = Quantity("Hz", at_least=0, positive=True)


class Lag(LinearBlock):
    """A first-order lag inside the chain: its input runs straight from sample to sample.

    Args:
        sample_period_s: T.
        cutoff_hz: f_c, where the gain is 1/√2.

    Raises:
        StageError: A cutoff that is not positive.
    """

    order = 1
    quantities: ClassVar[dict[str, Quantity]] = {"cutoff_hz": CUTOFF}

    def __init__(self, sample_period_s: float, cutoff_hz: float) -> None:
        super().__init__(sample_period_s)
        self.cutoff_hz = CUTOFF.parameter("cutoff_hz", cutoff_hz)

    def continuous(self) -> Matrices:
        omega = 2 * math.pi * self.cutoff_hz
        one = torch.ones_like(omega)
        return -omega.reshape(1, 1), omega.reshape(1), one.reshape(1), torch.zeros_like(omega)

    def extra_repr(self) -> str:
        return f"cutoff {self.cutoff_hz.item():g} Hz"
