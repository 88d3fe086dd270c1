"""Charge that leaks off a charge-driven stack: ẏ = ẋ - 2πf_c y, a first-order high-pass.

Fleming and Moheimani, *Improved current and charge amplifiers for driving piezoelectric loads*, 2003: below
f_c = 1/(2πRC) of the feedback resistance and the load, or of the integrator, a charge drive holds nothing.
"""

import math

import torch
from torch import nn

from torchpi.operators.linear import Matrices, discretise
from torchpi.stage.effects.effect import DataRange, Parameters, StateSpaceEffect, parameter

LEAST_LOST, FASTEST_HZ, APART = 0.03, 0.3, 3.0
"""Starts of a search: the share of a hold that the slowest leak loses in a record, the fastest leak unless
the record is too short for it, and the ratio of successive starts."""


class Leakage(StateSpaceEffect):
    """What is left of a displacement after its slow part, r with ṙ = 2πf_c (x - r), has leaked: y = x - r.

    The input is linear between samples.
    """

    name = "leakage"
    block = "actuator"
    equation = "ẏ = ẋ - 2πf_c y"
    signature = "a hold decays towards zero: slow, of the opposite sign to creep"
    time_scale = "slow"
    degenerate_with = ("thermal_drift",)
    left_by = ("creep",)
    corner_hz: nn.Parameter = parameter("Hz", at_least=0, at_most=100)
    order = 1

    def matrices(self) -> Matrices:
        omega = (2 * math.pi * self.corner_hz).reshape(1)
        one = torch.ones_like(omega)
        a, b, c, d = discretise(-omega[:, None], omega, -one, one[0], self.sample_period_s, "first")
        return a[0], b, c, d

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        # In a record of D seconds a hold loses the share 2πf_c D.
        low_hz = LEAST_LOST / (2 * math.pi * seen.duration_s)
        high_hz = max(FASTEST_HZ, 1 / seen.duration_s)
        count = 1 + math.floor(max(math.log(high_hz / low_hz) / math.log(APART), 0.0))
        bounds = cls.quantities["corner_hz"]
        return [{"corner_hz": f} for k in range(count) if (f := low_hz * APART**k) < bounds.at_most]
