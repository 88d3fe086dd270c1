"""An output resistance that charges the stack: v̇ = 2πf_c (u - v), f_c = 1/(2πR_oC_L)."""

import math

import torch
from torch import Tensor

from torchpi.operators.linear import Matrices
from torchpi.stage.effects.effect import Parameters, Seen
from torchpi.stage.effects.lag import FirstOrderLag


class AmplifierLag(FirstOrderLag):
    """A lag of a voltage that a converter holds; u(k) is held during the sample that ends at tick k."""

    name = "amplifier_lag"
    block = "amplifier"
    before_hysteresis = True
    equation = "v̇ = 2πf_c (u - v)"

    def is_ideal(self) -> bool:
        """Whether there is no lag at all."""
        return math.isinf(self.cutoff_hz.item())

    def decay(self, samples: Tensor) -> Tensor:
        """e^{-ω · samples · T}: what is left of a voltage after that many samples."""
        return torch.exp(-2 * math.pi * self.sample_period_s * self.cutoff_hz * samples)

    def matrices(self) -> Matrices:
        return self.discrete("end")

    @classmethod
    def starts(cls, seen: Seen) -> list[Parameters]:
        # Above a third of the sample rate a held input shows no lag.
        return [{"cutoff_hz": f} for f in (16.0, 60.0, 200.0, 700.0, 2500.0, 9000.0) if f < seen.fs_hz / 3]
