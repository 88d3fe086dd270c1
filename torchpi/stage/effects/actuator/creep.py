"""Creep of the ceramic: after a step, y(t) = y₀ [1 + γ log₁₀(t / 0.1 s)] (Jung and Gweon, 2000).

The logarithm is the operator `torchpi.operators.creep`: relaxations spread evenly over log time (Janocha
and Kuhnen, 2000), here from 1 ms to 1000 s, so that any record lies within them. Beside it stands one
relaxation more, one spring and damper of the model of Croft, Shed and Devasia (2001):

    y = [x + γ log…(x)] + g (x relaxed with τ)

The third form is the power law of a fractional-order element (Liu, Shan, Gabbert and Qi, *Hysteresis and
creep modeling and compensation for a piezoelectric actuator using a fractional-order Maxwell resistive
capacitor approach*, Smart Mater. Struct. 22, 2013),

    y(t) = y₀ {1 + p [(t / 0.1 s)^α - 1] / (α ln 10)},

which grows by p in a decade at 0.1 s, and tends to the logarithm as α → 0. Its spectrum of relaxations is
(t/t₀)^α = α/Γ(1-α) ∫ (1 - e^{-t/τ}) (τ/t₀)^α dτ/τ: the same poles as the logarithm's, their weights
growing as τ^α.
"""

import math
from typing import ClassVar

import torch
from torch import Tensor, nn

from torchpi.operators import creep
from torchpi.operators.linear import discretise
from torchpi.operators.quantity import Quantity
from torchpi.operators.relaxations import RelaxationsStream, relaxations
from torchpi.stage.effects.effect import SHORTEST_SLOW_S, LinearEffect, Needs, Parameters, Seen

# The operator sets poles from half a decade below the first time to one decade beyond the second.
FROM_S, TO_S = 1e-3 * math.sqrt(10), 100.0
MOST_PER_DECADE = 0.5


class Creep(LinearEffect):
    """Logarithmic creep, creep of one pole, of a power law, or all; the input runs straight between samples.

    The gain at once is such that γ and p leave the displacement 0.1 s after a step as it is; g adds to it.
    """

    name = "creep"
    block = "actuator"
    equation = "y = y₀ [1 + γ log₁₀(t/0.1 s)], or y = x + g r, τ ṙ = x - r, or y₀ [1 + p (t/0.1 s)^α …]"
    signature = "slow, follows the sign of the last move, grows with the time of a hold"
    time_scale = "slow"
    needs = Needs(duration_s=SHORTEST_SLOW_S)
    quantities: ClassVar[dict[str, Quantity]] = {
        "per_decade": Quantity("", at_least=0, at_most=MOST_PER_DECADE),
        "gain": Quantity("", at_least=0, at_most=0.5),
        "time_constant_s": Quantity("s", at_least=1e-3, at_most=1e4),
        "power_per_decade": Quantity("", at_least=0, at_most=MOST_PER_DECADE),
        "exponent": Quantity("", at_least=0.02, at_most=0.5),
    }
    identity: ClassVar[Parameters] = {
        "per_decade": 0.0,
        "gain": 0.0,
        "time_constant_s": 1.0,
        "power_per_decade": 0.0,
        "exponent": 0.2,
    }
    forms = ("logarithm", "pole", "power law")
    form_of: ClassVar[dict[str, str]] = {
        "per_decade": "logarithm",
        "gain": "pole",
        "power_per_decade": "power law",
    }
    per_decade: nn.Parameter
    gain: nn.Parameter
    time_constant_s: nn.Parameter
    power_per_decade: nn.Parameter
    exponent: nn.Parameter
    time_constants_s: Tensor
    decays: Tensor
    drives: Tensor
    at_once: Tensor

    def __init__(self, sample_period_s: float, **values: float) -> None:
        super().__init__(sample_period_s, **values)
        bank = creep.Creep(sample_period_s, MOST_PER_DECADE, FROM_S, TO_S)
        tau = bank.time_constants_s
        rate, one = (1 / tau)[:, None], torch.ones_like(tau)
        a, b, _, d = discretise(-rate[..., None], rate, one[:, None], 0 * one, sample_period_s, "first")
        self.poles_per_decade = bank.poles_per_decade
        # Not saved: they belong to the sample rate, not to the physics.
        self.register_buffer("time_constants_s", tau, persistent=False)
        self.register_buffer("decays", a[:, 0, 0], persistent=False)
        self.register_buffer("drives", b[:, 0], persistent=False)
        # What a pole of gain 1 adds to the gain at once, less what it has reached after 0.1 s.
        self.register_buffer("at_once", d + torch.expm1(-creep.REFERENCE_S / tau), persistent=False)

    def spectrum(self) -> Tensor:
        """The gain of each pole of the bank, (poles,)."""
        grown = (self.time_constants_s / creep.REFERENCE_S) ** self.exponent
        power = self.power_per_decade * torch.exp(-torch.lgamma(1 - self.exponent)) * grown
        return (self.per_decade + power) / self.poles_per_decade

    def discrete(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """a, b, c, d of the relaxations, the one pole last."""
        rate, gains = (1 / self.time_constant_s).reshape(1), self.spectrum()
        a, b, c, d = discretise(
            -rate[:, None],
            rate,
            self.gain.reshape(1),
            torch.zeros_like(self.gain),
            self.sample_period_s,
            "first",
        )
        return (
            torch.cat([self.decays, a[0]]),
            torch.cat([self.drives, b]),
            torch.cat([gains, c]),
            1 + (gains * self.at_once).sum() + d,
        )

    def initial_state(self, batch: int) -> Tensor:
        return torch.zeros(batch, len(self.decays) + 1, dtype=torch.float64)

    def forward(
        self,
        x: Tensor,  # (batch, time), µm
        state: Tensor | None = None,  # (batch, poles + 1), µm
    ) -> tuple[Tensor, Tensor]:
        return relaxations(x, *self.discrete(), self.initial_state(len(x)) if state is None else state)

    def stream(self) -> nn.Module:
        a, b, c, d = self.discrete()
        return RelaxationsStream(a.tolist(), b.tolist(), c.tolist(), d.item())

    @torch.no_grad()
    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        a, b, c, d = self.discrete()
        # A pole of no gain costs as much as any other; the bank needs one.
        used = c != 0
        used[-1] = True
        start = torch.zeros(len(dx), int(used.sum()), dtype=torch.float64)
        return relaxations(dx, a[used], b[used], c[used], d, start)[0]

    @classmethod
    def starts(cls, seen: Seen) -> list[Parameters]:
        # A pole slower than the record is a ramp, one of a few samples a change of gain.
        taus = [tau for tau in (0.03, 0.3, 3.0, 30.0) if 10 / seen.fs_hz < tau < 2 * seen.duration_s]
        power = {"power_per_decade": 0.01, "exponent": 0.2}
        return [{"per_decade": 0.01}, power, *({"gain": 0.01, "time_constant_s": tau} for tau in taus)]
