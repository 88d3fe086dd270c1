"""The remainder that no named effect explains: the smallest one that fits the data.

    y = x + Σ_j a_j ξ_j + Σ_j b_j (ξ_j x) / L,    τ_j ξ̇_j = x - ξ_j

It has memory on every time scale from a sample to the length of a record, linear and bilinear: a truncated
Volterra series on relaxations (Boyd and Chua, *Fading memory and the problem of approximating nonlinear
operators with Volterra series*, IEEE Trans. Circuits and Systems 32(11), 1985). It is linear in a and b,
which ridge regularisation keeps small.
"""

from typing import ClassVar

import torch
from torch import Tensor, nn

from torchpi.operators.base import StepStream
from torchpi.operators.quantity import Quantity
from torchpi.operators.relaxations import relaxations
from torchpi.stage.effects.effect import DataRange, Effect, Parameters, parameter

TIMES = 8


def remainder_step(x: float, n: list[float], s: list[float]) -> float:
    """Return x plus the remainder; n holds the decays, a, b and L, and s is ξ."""
    times = len(s)
    linear = n[times] * s[0]
    bilinear = n[2 * times] * s[0]
    for j in range(1, times):
        linear = linear + n[times + j] * s[j]
        bilinear = bilinear + n[2 * times + j] * s[j]
    # The batch form adds 0 · x last, which is what `observe` does with D = 0.
    linear = linear + 0.0 * x
    bilinear = bilinear + 0.0 * x
    for j in range(times):
        s[j] = n[j] * s[j] + (1.0 - n[j]) * x
    return x + linear + bilinear * x / n[3 * times]


class Unknown(Effect):
    """The unknown remainder: of the stage, and of no block."""

    name = "unknown"
    block = "sensor"
    equation = "y = x + Σ a_j ξ_j + Σ b_j ξ_j x / L"
    signature = "none that is known"
    state_size = TIMES
    length_um: nn.Parameter = parameter("µm", at_least=1e-9, at_most=1e9, identity=1.0)
    shortest_s: nn.Parameter = parameter("s", at_least=1e-7, at_most=1e7, identity=1e-3)
    longest_s: nn.Parameter = parameter("s", at_least=1e-7, at_most=1e7, identity=10.0)
    quantities: ClassVar[dict[str, Quantity]] = dict.fromkeys(
        [f"{letter}{j}" for letter in "ab" for j in range(TIMES)], Quantity("", at_least=-1e3, at_most=1e3)
    )

    def decay(self) -> Tensor:
        """Return e^{-T/τ_j}, (times,)."""
        share = torch.linspace(0, 1, TIMES, dtype=torch.float64)
        tau = self.shortest_s * (self.longest_s / self.shortest_s) ** share
        return torch.exp(-self.sample_period_s / tau)

    def weights(self, letter: str) -> Tensor:
        """Return a or b, (times,)."""
        return torch.stack([self.get_parameter(f"{letter}{j}") for j in range(TIMES)])

    def forward(
        self,
        x: Tensor,  # (batch, time), µm
        state: Tensor | None = None,  # (batch, times), µm
    ) -> tuple[Tensor, Tensor]:
        before = self.initial_state(len(x)) if state is None else state
        decay, zero = self.decay(), torch.zeros((), dtype=torch.float64)
        linear, after = relaxations(x, decay, 1 - decay, self.weights("a"), zero, before)
        bilinear, _ = relaxations(x, decay, 1 - decay, self.weights("b"), zero, before)
        return x + linear + bilinear * x / self.length_um, after

    def columns(
        self,
        x: Tensor,  # (1, time), µm
    ) -> Tensor:  # (2 times, time), µm
        """Return the signals that a_0 … a_7, b_0 … b_7 multiply in the output."""
        decay, zero, columns = self.decay(), torch.zeros((), dtype=torch.float64), []
        for one in torch.eye(TIMES, dtype=torch.float64):
            columns.append(relaxations(x, decay, 1 - decay, one, zero, self.initial_state(1))[0][0])
        states = torch.stack(columns)
        return torch.cat([states, states * x / self.length_um])

    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        with torch.no_grad():
            decay, zero = self.decay(), torch.zeros((), dtype=torch.float64)
            rest = self.initial_state(len(dx))
            b = self.weights("b")
            moved = dx + relaxations(dx, decay, 1 - decay, self.weights("a"), zero, rest)[0]
            state = relaxations(x, decay, 1 - decay, b, zero, self.initial_state(1))[0]
            along = relaxations(dx, decay, 1 - decay, b, zero, rest)[0]
            return moved + (along * x + state * dx) / self.length_um

    def stream(self) -> nn.Module:
        times = torch.cat([self.decay(), self.weights("a"), self.weights("b")])
        return StepStream(remainder_step, [*times.tolist(), self.length_um.item()], TIMES)

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        return []
