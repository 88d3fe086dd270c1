"""Creep of the ceramic: after a step, y(t) = y₀ [1 + γ log₁₀(t / 0.1 s)] (Jung and Gweon, 2000).

The logarithm is a sum of relaxations spread evenly over log time (Janocha and Kuhnen, 2000): with n poles per
decade, each of gain γ/n and time constant τ_i, the step response rises by γ in every decade that the poles
span. Two further relaxations act in parallel, the springs and dampers of the model of Croft, Shed and Devasia
(2001):

    y = [x + γ log…(x)] + g₁ (x relaxed with τ₁) + g₂ (x relaxed with τ₂)

The third form is the power law of a fractional-order element (Liu, Shan, Gabbert and Qi, *Hysteresis and
creep modeling and compensation for a piezoelectric actuator using a fractional-order Maxwell resistive
capacitor approach*, Smart Mater. Struct. 22, 2013),

    y(t) = y₀ {1 + p [(t / 0.1 s)^α - 1] / (α ln 10)},

which grows by p per decade at 0.1 s, and tends to the logarithm as α → 0. Its spectrum of relaxations is
(t/t₀)^α = α/Γ(1-α) ∫ (1 - e^{-t/τ}) (τ/t₀)^α dτ/τ, so it has the poles of the logarithm, with weights that
grow as τ^α.
"""

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor, nn

from torchpi.operators.linear import Matrices
from torchpi.operators.quantity import Quantity, check_order
from torchpi.operators.relaxations import relaxation
from torchpi.stage.effects.effect import DataRange, Parameters, StateSpaceEffect, parameter

REFERENCE_S = 0.1
"""After a step the displacement at this time is y₀, whatever γ and p."""
FASTEST_S, LARGEST = 1e-3, 0.5
"""Bounds of a single pole: its time constant, and its gain as a share of the travel. 1 to 20 % over minutes
are usual (Jung and Gweon, 2000); a fitted pole stands for several that the recordings do not tell apart."""
STARTS_S = (0.003, 0.01, 0.03, 0.1, 0.3, 3.0, 30.0)
"""Time constants from which a search begins."""
POLES_PER_DECADE = 2  # two follow the logarithm to 0.3 %, one to 11 %
# Poles from 1 ms to 1000 s, so that any record lies within them.
FROM_S, TO_S = 1e-3 * math.sqrt(10), 100.0
FIRST_DECADE = math.sqrt(10)
"""Middle of the logarithm's first decade, relative to where it begins."""


class Bank(NamedTuple):
    """Relaxations of gain g_i: x_i⁺ = a_i x_i + b_i u, y = u + Σ g_i (x_i + d_i u); (poles,) each."""

    tau: Tensor
    """τ_i, s."""
    a: Tensor
    b: Tensor
    at_once: Tensor
    """d_i: the part relaxed within the sample, minus the part relaxed after 0.1 s."""
    share: Tensor
    """Share of a whole pole: 1, and less for the last, so that the sum varies smoothly with the two times."""


def bank(sample_period_s: float, from_s: Tensor, to_s: float) -> Bank:
    """Return the poles of a logarithm, or a power law, that holds from one time to another."""
    tau, share = time_constants(from_s, to_s)
    a, b, d = relaxation(sample_period_s / tau, "first")
    return Bank(tau, a, b, d + torch.expm1(-REFERENCE_S / tau), share)


def time_constants(from_s: Tensor, to_s: float) -> tuple[Tensor, Tensor]:
    """Return τ_i and the share of a whole pole, (poles,) each.

    Poles reach half a decade below the first time and one decade beyond the second, which keeps the rise
    within 5 % of γ at both ends as well.
    """
    last = POLES_PER_DECADE * (torch.log10(to_s / from_s) + 1.5)
    steps = torch.arange(math.ceil(last.item()) + 1, dtype=torch.float64)
    return from_s * 10 ** (steps / POLES_PER_DECADE - 0.5), torch.clamp(last + 1 - steps, max=1.0)


class Creep(StateSpaceEffect):
    """Logarithmic creep, creep of one or two poles, of a power law, or all; the input runs straight between
    samples.

    The immediate gain is such that γ and p do not change the displacement 0.1 s after a step; g adds to it.
    The logarithm and the power law hold from `from_s`, which may be fitted, to `to_s`.
    """

    name = "creep"
    block = "actuator"
    equation = "y = y₀ [1 + γ log₁₀(t/0.1 s)], or y = x + Σ g r, τ ṙ = x - r, or y₀ [1 + p (t/0.1 s)^α …]"
    signature = "slow, follows the sign of the last move, grows with the duration of a hold"
    time_scale = "slow"
    degenerate_with = ("thermal_drift",)
    left_by = ("leakage",)
    per_decade: nn.Parameter = parameter("", at_least=0, at_most=0.5)
    gain: nn.Parameter = parameter("", at_least=0, at_most=LARGEST)
    time_constant_s: nn.Parameter = parameter("s", at_least=FASTEST_S, at_most=1e4, identity=1.0)
    slow_gain: nn.Parameter = parameter("", at_least=0, at_most=LARGEST)
    slow_time_constant_s: nn.Parameter = parameter("s", at_least=FASTEST_S, at_most=1e4, identity=10.0)
    power_per_decade: nn.Parameter = parameter("", at_least=0, at_most=0.5)
    exponent: nn.Parameter = parameter("", at_least=0.02, at_most=0.5, identity=0.2)
    # Each decade has its poles; between these bounds there are 40.
    from_s: nn.Parameter = parameter("s", at_least=1e-9, at_most=1e9, identity=FROM_S)
    to_s: nn.Parameter = parameter("s", at_least=1e-9, at_most=1e9, identity=TO_S)
    accepted: ClassVar[dict[str, Quantity]] = {"per_decade": Quantity("", at_least=-0.5, at_most=0.5)}
    forms = ("logarithm", "pole", "two poles", "power law")
    form_of: ClassVar[dict[str, str]] = {
        "per_decade": "logarithm",
        "gain": "pole",
        "power_per_decade": "power law",
    }
    kinds = ("to_s",)

    def __init__(self, sample_period_s: float, **values: float) -> None:
        super().__init__(sample_period_s, **values)
        check_order("from_s", self.from_s.item(), "to_s", self.to_s.item(), "s")

    @classmethod
    def form(cls, values: Mapping[str, float]) -> str:
        gains = [values.get(name, 0.0) for name in ("gain", "slow_gain")]
        named = super().form({**values, "gain": max(gains)})
        return named.replace("pole", "two poles") if all(gains) else named

    @classmethod
    def reached(cls, values: Mapping[str, float], seen: DataRange) -> bool:
        times = [values[name] for name in ("time_constant_s", "slow_time_constant_s") if name in values]
        if "from_s" in values:
            times.append(FIRST_DECADE * values["from_s"])
        return min(times, default=math.inf) >= seen.quickest_s

    def bank(self) -> Bank:
        """Return the poles of the logarithm and the power law."""
        return bank(self.sample_period_s, self.from_s, self.to_s.item())

    def spectrum(self, poles: Bank) -> Tensor:
        """Return the gain of each pole of the bank, (poles,)."""
        grown = (poles.tau / REFERENCE_S) ** self.exponent
        power = self.power_per_decade * torch.exp(-torch.lgamma(1 - self.exponent)) * grown
        return (self.per_decade + power) * poles.share / POLES_PER_DECADE

    def matrices(self) -> Matrices:
        # The two single poles are the last.
        poles = self.bank()
        gains = self.spectrum(poles)
        own = torch.stack([self.gain, self.slow_gain])
        tau = torch.stack([self.time_constant_s, self.slow_time_constant_s])
        a, b, d = relaxation(self.sample_period_s / tau, "first")
        return (
            torch.cat([poles.a, a]),
            torch.cat([poles.b, b]),
            torch.cat([gains, own]),
            1 + (gains * poles.at_once).sum() + (own * d).sum(),
        )

    def initial_state(self, batch: int) -> Tensor:
        poles, _ = time_constants(self.from_s, self.to_s.item())
        return torch.zeros(batch, len(poles) + 2, dtype=torch.float64)

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        # A pole slower than the record looks like a ramp, one of a few samples like a change of gain.
        taus = [tau for tau in STARTS_S if max(10 / seen.fs_hz, seen.quickest_s) < tau < 2 * seen.duration_s]
        power = {"power_per_decade": 0.01, "exponent": 0.2}
        pole = [{"gain": 0.01, "time_constant_s": tau} for tau in taus]
        two = [
            {**one, "slow_gain": 0.01, "slow_time_constant_s": later["time_constant_s"]}
            for one, later in pairwise(pole)
        ]
        begins = [{"per_decade": 0.01, "from_s": tau} for tau in taus]
        return [{"per_decade": 0.01}, *begins, power, *pole, *two]
