"""Charge that leaks off a charge-driven stack: ẏ = ẋ - 2πf_c y, a first-order high-pass.

Fleming and Moheimani, *Improved current and charge amplifiers for driving piezoelectric loads*, 2003: below
f_c = 1/(2πRC) of the feedback resistance and the load, or of the integrator, a charge drive holds nothing.
"""

import math

import torch
from torch import nn

from torchpi.operators.linear import Matrices, discretise
from torchpi.stage.effects.effect import (
    SHORTEST_SLOW_S,
    DataRange,
    Needs,
    Parameters,
    StateSpaceEffect,
    parameter,
)


class Leakage(StateSpaceEffect):
    """What is left of a displacement after its slow part, r with ṙ = 2πf_c (x - r), has leaked: y = x - r.

    The input runs straight from sample to sample.
    """

    name = "leakage"
    block = "actuator"
    equation = "ẏ = ẋ - 2πf_c y"
    signature = "a hold decays towards zero: slow, of the opposite sign to creep"
    time_scale = "slow"
    needs = Needs(duration_s=SHORTEST_SLOW_S)
    degenerate_with = ("thermal_drift",)
    left_by = ("creep",)
    corner_hz: nn.Parameter = parameter("Hz", at_least=0, at_most=10)
    order = 1

    def matrices(self) -> Matrices:
        omega = (2 * math.pi * self.corner_hz).reshape(1)
        one = torch.ones_like(omega)
        a, b, c, d = discretise(-omega[:, None], omega, -one, one[0], self.sample_period_s, "first")
        return a[0], b, c, d

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        # In a record of D seconds a hold loses 2πf_c D of itself: under 0.2 % is not to be seen.
        corners = (0.003, 0.01, 0.03, 0.1, 0.3)
        return [{"corner_hz": f} for f in corners if 2e-3 < 2 * math.pi * f * seen.duration_s]
