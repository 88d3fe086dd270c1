"""Creep of the ceramic: after a step, y(t) = y₀ [1 + γ log₁₀(t / 0.1 s)] (Jung and Gweon, 2000).

The logarithm is the operator `torchpi.operators.creep`: relaxations spread evenly over log time (Janocha
and Kuhnen, 2000), here from 1 ms to 1000 s, so that any record lies within them. Beside it stands one
relaxation more, one spring and damper of the model of Croft, Shed and Devasia (2001):

    y = [x + γ log…(x)] + g (x relaxed with τ)
"""

import math
from typing import ClassVar

import torch
from torch import Tensor, nn

from torchpi.operators import creep
from torchpi.operators.linear import discretise
from torchpi.operators.quantity import Quantity
from torchpi.operators.relaxations import RelaxationsStream, relaxations
from torchpi.stage.effects.effect import LinearEffect, Parameters, Seen

# The operator sets poles from half a decade below the first time to one decade beyond the second.
FROM_S, TO_S = 1e-3 * math.sqrt(10), 100.0
MOST_PER_DECADE = 0.5


class Creep(LinearEffect):
    """Logarithmic creep, creep of one pole, or both; the input runs straight from sample to sample.

    The gain at once is such that γ leaves the displacement 0.1 s after a step as it is; g adds to it.
    """

    name = "creep"
    block = "actuator"
    equation = "y = y₀ [1 + γ log₁₀(t / 0.1 s)], or y = x + g r, τ ṙ = x - r"
    signature = "slow, follows the sign of the last move, grows with the time of a hold"
    quantities: ClassVar[dict[str, Quantity]] = {
        "per_decade": Quantity("", at_least=0, at_most=MOST_PER_DECADE),
        "gain": Quantity("", at_least=0, at_most=0.5),
        "time_constant_s": Quantity("s", at_least=1e-3, at_most=1e4),
    }
    identity: ClassVar[Parameters] = {"per_decade": 0.0, "gain": 0.0, "time_constant_s": 1.0}
    per_decade: nn.Parameter
    gain: nn.Parameter
    time_constant_s: nn.Parameter
    decays: Tensor
    drives: Tensor
    log_gains: Tensor
    log_at_once: Tensor

    def __init__(self, sample_period_s: float, **values: float) -> None:
        super().__init__(sample_period_s, **values)
        # The bank is a straight line in γ: made once, at the largest γ, and scaled from there.
        with torch.no_grad():
            a, b, c, d = creep.Creep(sample_period_s, MOST_PER_DECADE, FROM_S, TO_S).discrete()
        # Not saved: they belong to the sample rate, not to the physics.
        self.register_buffer("decays", a, persistent=False)
        self.register_buffer("drives", b, persistent=False)
        self.register_buffer("log_gains", c / MOST_PER_DECADE, persistent=False)
        self.register_buffer("log_at_once", (d - 1) / MOST_PER_DECADE, persistent=False)

    def discrete(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """a, b, c, d of the relaxations, the one pole last."""
        rate = (1 / self.time_constant_s).reshape(1)
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
            torch.cat([self.per_decade * self.log_gains, c]),
            1 + self.per_decade * self.log_at_once + d,
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
        return [{"per_decade": 0.01}, *({"gain": 0.01, "time_constant_s": tau} for tau in taus)]
