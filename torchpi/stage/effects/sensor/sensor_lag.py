"""The low-pass of a sensor and its electronics: ẏ = 2πf_c (x - y)."""

import math
from typing import ClassVar

import torch
from torch import nn

from torchpi.operators.linear import Hold, Matrices
from torchpi.operators.quantity import CUTOFF, Quantity
from torchpi.stage.effects.effect import Parameters, Seen, StateSpaceEffect


class SensorLag(StateSpaceEffect):
    """A first-order lag of a displacement that runs straight from sample to sample.

    In closed form, which an infinite cutoff leaves exact: with a = e^{-ωT}, ω = 2πf_c, Γ₀ = 1 - a and
    Γ₁ = 1 - Γ₀ / ωT,

        y(k) = z(k) + Γ₁ x(k),   z(k+1) = a z(k) + (Γ₀ - Γ₁ + a Γ₁) x(k)
    """

    name = "sensor_lag"
    block = "sensor"
    equation = "ẏ = 2πf_c (x - y)"
    signature = "phase grows in proportion to frequency, the gain rolls off"
    quantities: ClassVar[dict[str, Quantity]] = {"cutoff_hz": Quantity("Hz", at_least=1.0, at_most=1e6)}
    identity: ClassVar[Parameters] = {"cutoff_hz": math.inf}
    accepted: ClassVar[dict[str, Quantity]] = {"cutoff_hz": CUTOFF}
    cutoff_hz: nn.Parameter
    order = 1
    hold: Hold = "first"

    def matrices(self) -> Matrices:
        omega_t = (2 * math.pi * self.sample_period_s * self.cutoff_hz).reshape(1)
        a, gamma0 = torch.exp(-omega_t), -torch.expm1(-omega_t)
        if self.hold == "end":
            return a, a * gamma0, torch.ones_like(a), gamma0[0]
        gamma1 = 1 - gamma0 / omega_t
        return a, gamma0 - gamma1 + a * gamma1, torch.ones_like(a), gamma1[0]

    @classmethod
    def starts(cls, seen: Seen) -> list[Parameters]:
        # Near half of the sample rate a lag is little more than a change of gain.
        highest = min(20e3, 0.45 * seen.fs_hz)
        return [{"cutoff_hz": f} for f in (30.0, 110.0, 400.0, 1500.0, 5500.0, 20e3) if f <= highest]
