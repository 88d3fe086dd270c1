"""An output resistance that charges the stack: v̇ = 2πf_c (u - v), f_c = 1/(2πR_oC_L).

The second form is a feedback amplifier with two poles in its loop: an integrator of unity gain at f_c and the
load behind it (Gray and Meyer, *Analysis and Design of Analog Integrated Circuits*, the two-pole feedback
amplifier).
"""

import math

import torch
from torch import Tensor

from torchpi.operators.linear import Matrices
from torchpi.stage.effects.effect import DataRange, Parameters
from torchpi.stage.effects.lag import Lag


class AmplifierLag(Lag):
    """A lag of a voltage that a converter holds; u(k) is held during the sample that ends at tick k."""

    name = "amplifier_lag"
    block = "amplifier"
    before_hysteresis = True
    equation = "v̇ = 2πf_c (u - v), or v + v̇/ω_c + v̈/(4ζ²ω_c²) = u"
    smooths = True
    degenerate_with = ("sensor_lag",)

    def decay(self, samples: Tensor) -> Tensor:
        """Return e^{-ω · samples · T}, the share of a voltage left behind one pole after so many samples."""
        return torch.exp(-2 * math.pi * self.sample_period_s * self.cutoff_hz * samples)

    def matrices(self) -> Matrices:
        return self.discrete("end")

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        # Above a third of the sample rate a held input shows no lag.
        return cls.starts_below(seen, seen.fs_hz / 3)
