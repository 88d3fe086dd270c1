"""Creep of the ceramic: after a step, y(t) = y₀ [1 + γ log₁₀(t / 0.1 s)] (Jung and Gweon, 2000).

The logarithm is a sum of relaxations spread evenly over log time (Janocha and Kuhnen, 2000): with n poles a
decade, each of gain γ/n and time constant τ_i, the step response rises by γ in every decade that the poles
span. Beside it stands one relaxation more, one spring and damper of the model of Croft, Shed and Devasia
(2001):

    y = [x + γ log…(x)] + g (x relaxed with τ)
"""

import math
from functools import lru_cache
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor, nn

from torchpi.operators.linear import Matrices, discretise
from torchpi.operators.quantity import Quantity, check_order
from torchpi.operators.relaxations import relaxations
from torchpi.stage.effects.effect import Parameters, Seen, StateSpaceEffect

REFERENCE_S = 0.1
"""After a step the displacement at this time is y₀, whatever γ."""
POLES_PER_DECADE = 2  # they follow the logarithm to 0.3 %, one would to 11 %
# Poles from 1 ms to 1000 s, so that any record lies within them.
FROM_S, TO_S = 1e-3 * math.sqrt(10), 100.0


class Bank(NamedTuple):
    """The logarithm's relaxations at γ = 1: x_i⁺ = a_i x_i + b_i u, y = u + γ (Σ c_i x_i + d u)."""

    a: Tensor
    b: Tensor
    c: Tensor
    d: Tensor


@lru_cache(maxsize=256)
def bank(sample_period_s: float, from_s: float, to_s: float) -> Bank:
    """The relaxations of a logarithm that holds from one time to another.

    Poles reach half a decade below the first time and one decade beyond the second, which keeps the rise
    within 5 % of γ there as well.
    """
    with torch.inference_mode(False):  # what is kept is for training as well
        decades = math.log10(to_s / from_s) + 1.5
        steps = torch.arange(math.ceil(decades * POLES_PER_DECADE) + 1, dtype=torch.float64)
        tau = from_s * 10 ** (steps / POLES_PER_DECADE - 0.5)
        gain = torch.full_like(tau, 1 / POLES_PER_DECADE)
        rate = (1 / tau)[:, None]
        a, b, c, d = discretise(
            -rate[..., None], rate, gain[:, None], torch.zeros_like(tau), sample_period_s, "first"
        )
        at_once = (gain * torch.expm1(-REFERENCE_S / tau)).sum()
        return Bank(a[:, 0, 0], b[:, 0], c[:, 0], at_once + d.sum())


class Creep(StateSpaceEffect):
    """Logarithmic creep, creep of one pole, or both; the input runs straight from sample to sample.

    The gain at once is such that γ leaves the displacement 0.1 s after a step as it is; g adds to it. The
    logarithm holds from `from_s` to `to_s`.
    """

    name = "creep"
    block = "actuator"
    equation = "y = y₀ [1 + γ log₁₀(t / 0.1 s)], or y = x + g r, τ ṙ = x - r"
    signature = "slow, follows the sign of the last move, grows with the time of a hold"
    quantities: ClassVar[dict[str, Quantity]] = {
        "per_decade": Quantity("", at_least=0, at_most=0.5),
        "gain": Quantity("", at_least=0, at_most=0.5),
        "time_constant_s": Quantity("s", at_least=1e-3, at_most=1e4),
        "from_s": Quantity("s", at_least=0, positive=True),
        "to_s": Quantity("s", at_least=0, positive=True),
    }
    accepted: ClassVar[dict[str, Quantity]] = {"per_decade": Quantity("", at_least=-0.5, at_most=0.5)}
    identity: ClassVar[Parameters] = {
        "per_decade": 0.0,
        "gain": 0.0,
        "time_constant_s": 1.0,
        "from_s": FROM_S,
        "to_s": TO_S,
    }
    kinds = ("from_s", "to_s")
    per_decade: nn.Parameter
    gain: nn.Parameter
    time_constant_s: nn.Parameter
    from_s: nn.Parameter
    to_s: nn.Parameter

    def __init__(self, sample_period_s: float, **values: float) -> None:
        super().__init__(sample_period_s, **values)
        check_order("from_s", self.from_s.item(), "to_s", self.to_s.item(), "s")

    def logarithm(self) -> Bank:
        """Its relaxations at γ = 1."""
        return bank(self.sample_period_s, self.from_s.item(), self.to_s.item())

    def matrices(self) -> Matrices:
        # The one pole is the last.
        log = self.logarithm()
        rate, direct = (1 / self.time_constant_s).reshape(1), torch.zeros_like(self.gain)
        a, b, c, d = discretise(
            -rate[:, None], rate, self.gain.reshape(1), direct, self.sample_period_s, "first"
        )
        return (
            torch.cat([log.a, a[0]]),
            torch.cat([log.b, b]),
            torch.cat([self.per_decade * log.c, c]),
            1 + self.per_decade * log.d + d,
        )

    def initial_state(self, batch: int) -> Tensor:
        return torch.zeros(batch, len(self.logarithm().a) + 1, dtype=torch.float64)

    @torch.no_grad()
    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        a, b, c, d = self.matrices()
        # A pole of no gain costs as much as any other; the bank needs one.
        used = c != 0
        used[-1] = True
        start = torch.zeros(len(dx), int(used.sum()), dtype=torch.float64)
        return relaxations(dx, a[used], b[used], c[used], d, start)[0]

    @classmethod
    def starts(cls, seen: Seen) -> list[Parameters]:
        # A pole slower than the record is a ramp, one of a few samples a change of gain.
        taus = [tau for tau in (0.03, 0.3, 3.0, 30.0) if 10 / seen.fs_hz < tau < 2 * seen.duration_s]
        return [{"per_decade": 0.01}, *({"gain": 0.01, "time_constant_s": tau} for tau in taus)]
