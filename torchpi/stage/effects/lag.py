"""The lag ẏ = 2πf_c (x - y) of a voltage or of a reading, and a lag of two poles.

The second form has an integrator of unity gain at f_c and another pole at f_2 behind it:

    ẇ = 2πf_c (x - y),    ẏ = 2πf_2 (w - y),    f_2 = 4ζ² f_c

so that Y/X = 1 / (1 + s/ω_c + s²/ω_cω_2), with damping ratio ζ = ½ √(f_2/f_c). ζ → ∞ gives one pole again.
"""

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor, nn

from torchpi.operators.linear import Hold, Matrices, discretise
from torchpi.operators.quantity import Quantity
from torchpi.operators.relaxations import relaxation
from torchpi.stage.effects.effect import DataRange, Parameters, StateSpaceEffect, parameter

APART = 3.6
"""Ratio of successive starts of a search; a fit converges from a factor of two away."""
FLATTEST = 0.5**0.5
"""The damping ratio of the flattest gain, at which a fit of two poles starts."""


class Lag(StateSpaceEffect):
    """One pole in closed form, which an infinite cutoff leaves exact: a = e^{-ωT}, ω = 2πf_c, Γ₀ = 1 - a.

    For an input that is held during the sample that ends at tick k,

        y(k) = z(k) + Γ₀ x(k),   z(k+1) = a y(k)

    and for an input that is linear between samples, with Γ₁ = 1 - Γ₀ / ωT,

        y(k) = z(k) + Γ₁ x(k),   z(k+1) = a z(k) + (Γ₀ - Γ₁ + a Γ₁) x(k)

    With a finite `damping_ratio` there are two poles and two states; below its bound the lag would ring like
    a mode.
    """

    equation = "ẏ = 2πf_c (x - y), or y + ẏ/ω_c + ÿ/(4ζ²ω_c²) = x"
    signature = "phase grows in proportion to frequency, the gain rolls off"
    time_scale = "fast"
    delays = True
    forms = ("one pole", "two poles")
    cutoff_hz: nn.Parameter = parameter("Hz", at_least=1e-3, at_most=1e6, identity=math.inf)
    damping_ratio: nn.Parameter = parameter("", at_least=0.35, at_most=10.0, identity=math.inf)
    accepted: ClassVar[dict[str, Quantity]] = {"cutoff_hz": Quantity("Hz", at_least=0, positive=True)}

    @classmethod
    def form(cls, values: Mapping[str, float]) -> str:
        of = {**cls.identity, **values}
        if math.isinf(of["cutoff_hz"]):
            return ""
        return "one pole" if math.isinf(of["damping_ratio"]) else "two poles"

    def is_ideal(self) -> bool:
        """Whether there is no lag at all."""
        return math.isinf(self.cutoff_hz.item())

    def poles(self) -> int:
        """Return the number of poles, which is also that of the states."""
        return 1 if self.is_ideal() or math.isinf(self.damping_ratio.item()) else 2

    def discrete(self, hold: Hold) -> Matrices:
        """Return the discrete block for this hold of the input, "end" or "first"."""
        if self.poles() == 2:
            return discretise(*self.continuous(), self.sample_period_s, hold)
        omega_t = (2 * math.pi * self.sample_period_s * self.cutoff_hz).reshape(1)
        a, b, d = relaxation(omega_t, hold)
        return a, b, torch.ones_like(a), d[0]

    def continuous(self) -> Matrices:
        """Return A, B, C, D of the two poles; the states are y and w."""
        omega = 2 * math.pi * self.cutoff_hz
        second, zero = 4 * self.damping_ratio**2 * omega, torch.zeros_like(omega)
        a = torch.stack([-second, second, -omega, zero]).reshape(2, 2)
        return a, torch.stack([zero, omega]), torch.stack([torch.ones_like(omega), zero]), zero

    def initial_state(self, batch: int) -> Tensor:
        return torch.zeros(batch, self.poles(), dtype=torch.float64)

    @staticmethod
    def starts_below(seen: DataRange, highest_hz: float) -> list[Parameters]:
        """Return starts of a search, with one pole and with two: from `highest_hz` downward, as long as the
        lag settles within a recording."""
        count = 1 + math.floor(max(math.log(highest_hz * seen.duration_s) / math.log(APART), 0.0))
        one = [{"cutoff_hz": highest_hz / APART**k} for k in range(count)]
        return one + [{**start, "damping_ratio": FLATTEST} for start in one]
