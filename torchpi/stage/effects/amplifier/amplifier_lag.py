"""An output resistance that charges the stack: v̇ = 2πf_c (u - v), f_c = 1/(2πR_oC_L).

In its second form a feedback amplifier with two poles in its loop, an integrator of unity gain at f_c and the
load behind it at f_2:

    ẇ = 2πf_c (u - v),    v̇ = 2πf_2 (w - v),    f_2 = 4ζ² f_c

so that V/U = 1 / (1 + s/ω_c + s²/ω_cω_2), of damping ratio ζ = ½ √(f_2/f_c) (Gray and Meyer, *Analysis and
Design of Analog Integrated Circuits*, the two-pole feedback amplifier). ζ → ∞ is the one pole again.
"""

import math
from collections.abc import Mapping

import torch
from torch import Tensor, nn

from torchpi.operators.linear import Matrices, discretise
from torchpi.stage.effects.effect import DataRange, Parameters, parameter
from torchpi.stage.effects.lag import FirstOrderLag

FLATTEST = 0.5**0.5
"""The damping ratio of the flattest gain, where a fit of two poles begins."""


class AmplifierLag(FirstOrderLag):
    """A lag of a voltage that a converter holds; u(k) is held during the sample that ends at tick k.

    With a finite `damping_ratio` there are two poles, and two states; below its bound the amplifier rings,
    which is a mode.
    """

    name = "amplifier_lag"
    block = "amplifier"
    before_hysteresis = True
    equation = "v̇ = 2πf_c (u - v), or v + v̇/ω_c + v̈/(4ζ²ω_c²) = u"
    smooths = True
    degenerate_with = ("sensor_lag",)
    forms = ("one pole", "two poles")
    damping_ratio: nn.Parameter = parameter("", at_least=0.35, at_most=10.0, identity=math.inf)

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
        """How many poles, and states, there are."""
        return 1 if self.is_ideal() or math.isinf(self.damping_ratio.item()) else 2

    def decay(self, samples: Tensor) -> Tensor:
        """e^{-ω · samples · T}: what is left of a voltage behind the one pole after that many samples."""
        return torch.exp(-2 * math.pi * self.sample_period_s * self.cutoff_hz * samples)

    def matrices(self) -> Matrices:
        if self.poles() == 1:
            return self.discrete("end")
        return discretise(*self.continuous(), self.sample_period_s, "end")

    def continuous(self) -> Matrices:
        """A, B, C, D of the two poles; the states are v and w."""
        omega = 2 * math.pi * self.cutoff_hz
        second, zero = 4 * self.damping_ratio**2 * omega, torch.zeros_like(omega)
        a = torch.stack([-second, second, -omega, zero]).reshape(2, 2)
        return a, torch.stack([zero, omega]), torch.stack([torch.ones_like(omega), zero]), zero

    def initial_state(self, batch: int) -> Tensor:
        return torch.zeros(batch, self.poles(), dtype=torch.float64)

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        # Above a third of the sample rate a held input shows no lag.
        one = [{"cutoff_hz": f} for f in cls.cutoffs_hz(seen, seen.fs_hz / 3)]
        return one + [{**start, "damping_ratio": FLATTEST} for start in one]
