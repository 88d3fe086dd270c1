"""The first-order lag ẏ = 2πf_c (x - y), of a voltage or of a reading."""

import math
from typing import ClassVar

import torch
from torch import nn

from torchpi.operators.linear import Hold, Matrices
from torchpi.operators.quantity import Quantity
from torchpi.stage.effects.effect import DataRange, StateSpaceEffect, parameter

APART = 3.6
"""Times that one start of a search lies below the last: a fit finds its way from a factor of two."""


class FirstOrderLag(StateSpaceEffect):
    """In closed form, which an infinite cutoff leaves exact: a = e^{-ωT}, ω = 2πf_c, Γ₀ = 1 - a.

    Of an input that is held in the sample that ends at tick k,

        y(k) = z(k) + Γ₀ x(k),   z(k+1) = a y(k)

    and of one that runs straight from sample to sample, with Γ₁ = 1 - Γ₀ / ωT,

        y(k) = z(k) + Γ₁ x(k),   z(k+1) = a z(k) + (Γ₀ - Γ₁ + a Γ₁) x(k)
    """

    equation = "ẏ = 2πf_c (x - y)"
    signature = "phase grows in proportion to frequency, the gain rolls off"
    time_scale = "fast"
    delays = True
    cutoff_hz: nn.Parameter = parameter("Hz", at_least=1e-3, at_most=1e6, identity=math.inf)
    accepted: ClassVar[dict[str, Quantity]] = {"cutoff_hz": Quantity("Hz", at_least=0, positive=True)}
    order = 1

    def discrete(self, hold: Hold) -> Matrices:
        """The block for this kind of input, "end" or "first"."""
        omega_t = (2 * math.pi * self.sample_period_s * self.cutoff_hz).reshape(1)
        a, gamma0 = torch.exp(-omega_t), -torch.expm1(-omega_t)
        if hold == "end":
            return a, a * gamma0, torch.ones_like(a), gamma0[0]
        gamma1 = 1 - gamma0 / omega_t
        return a, gamma0 - gamma1 + a * gamma1, torch.ones_like(a), gamma1[0]

    @staticmethod
    def cutoffs_hz(seen: DataRange, highest_hz: float) -> list[float]:
        """Where a search may begin: from a cutoff downward, as long as the lag ends within a recording."""
        count = 1 + math.floor(max(math.log(highest_hz * seen.duration_s) / math.log(APART), 0.0))
        return [highest_hz / APART**k for k in range(count)]
