"""Creep: after a step, y(t) = y₀ [1 + γ log₁₀(t / 0.1 s)] (Jung and Gweon, 2000).

The logarithm is a sum of relaxations spread evenly over log time (Janocha and Kuhnen, 2000): with n
poles a decade, each of gain γ/n and time constant τ_i, the step response rises by γ in every decade that
the poles span. The gain at once is such that the displacement 0.1 s after the step is y₀, whatever γ.
"""

import math
from typing import ClassVar

import torch
from torch import Tensor, nn

from torchpi.operators.base import Operator
from torchpi.operators.linear import discretise
from torchpi.operators.quantity import Quantity, check_order
from torchpi.operators.relaxations import RelaxationsStream, relaxations

REFERENCE_S = 0.1


class Creep(Operator):
    """Logarithmic creep of a displacement; its input runs straight from sample to sample.

    Args:
        sample_period_s: T.
        per_decade: γ, the share of a step that is added in each decade of time; trainable.
        from_s: Where the logarithm begins to hold.
        to_s: Where it ends. Poles reach half a decade below `from_s` and one decade beyond `to_s`, which
            keeps the rise within 5 % of γ there as well.
        poles_per_decade: Two follow the logarithm to 0.3 %, one to 11 %.

    Raises:
        StageError: Times out of order, or a number out of its limits.
    """

    quantities: ClassVar[dict[str, Quantity]] = {
        "per_decade": Quantity("", at_least=-0.5, at_most=0.5),
        "from_s": Quantity("s", at_least=0, positive=True),
        "to_s": Quantity("s", at_least=0, positive=True),
        "poles_per_decade": Quantity("", at_least=1, at_most=10),
    }

    def __init__(
        self,
        sample_period_s: float,
        per_decade: float,
        from_s: float = 0.1,
        to_s: float = 100.0,
        poles_per_decade: int = 2,
    ) -> None:
        super().__init__()
        self.sample_period_s = sample_period_s
        self.per_decade = self.quantities["per_decade"].parameter("per_decade", per_decade)
        self.from_s = self.quantities["from_s"].check("from_s", from_s)
        self.to_s = self.quantities["to_s"].check("to_s", to_s)
        poles = self.quantities["poles_per_decade"].check("poles_per_decade", poles_per_decade)
        self.poles_per_decade = int(poles)
        check_order("from_s", from_s, "to_s", to_s, "s")
        decades = math.log10(to_s / from_s) + 1.5
        steps = torch.arange(math.ceil(decades * self.poles_per_decade) + 1, dtype=torch.float64)
        self.time_constants_s: Tensor
        self.register_buffer("time_constants_s", from_s * 10 ** (steps / self.poles_per_decade - 0.5))

    def discrete(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """a, b, c, d of the relaxations, gradients to `per_decade` attached."""
        tau = self.time_constants_s
        gain = self.per_decade / self.poles_per_decade * torch.ones_like(tau)
        at_once = 1 - (gain * -torch.expm1(-REFERENCE_S / tau)).sum()
        rate = (1 / tau)[:, None]
        a, b, c, d = discretise(
            -rate[..., None], rate, gain[:, None], torch.zeros_like(tau), self.sample_period_s, "first"
        )
        return a[:, 0, 0], b[:, 0], c[:, 0], at_once + d.sum()

    def initial_state(self, batch: int) -> Tensor:
        return torch.zeros(batch, len(self.time_constants_s), dtype=torch.float64)

    def forward(
        self,
        x: Tensor,  # (batch, time), µm
        state: Tensor | None = None,  # (batch, poles), µm
    ) -> tuple[Tensor, Tensor]:
        return relaxations(x, *self.discrete(), self.initial_state(len(x)) if state is None else state)

    def stream(self) -> nn.Module:
        a, b, c, d = self.discrete()
        return RelaxationsStream(a.tolist(), b.tolist(), c.tolist(), d.item())

    def extra_repr(self) -> str:
        return f"{100 * self.per_decade.item():g} % a decade, {len(self.time_constants_s)} poles"
