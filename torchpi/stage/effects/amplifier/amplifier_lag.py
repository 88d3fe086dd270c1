"""An output resistance that charges the stack: v̇ = 2πf_c (u - v), f_c = 1/(2πR_oC_L)."""

import math
from typing import ClassVar

import torch
from torch import Tensor, nn

from torchpi.operators.linear import LinearStream, state_space
from torchpi.operators.quantity import Quantity
from torchpi.stage.effects.effect import LinearEffect, Parameters, Seen


class AmplifierLag(LinearEffect):
    """A first-order lag of a voltage that a converter holds: v(k) = e^{-ωT} v(k-1) + (1 - e^{-ωT}) u(k).

    u(k) is the command held during the sample that ends at tick k.
    """

    name = "amplifier_lag"
    block = "amplifier"
    before_hysteresis = True
    equation = "v̇ = 2πf_c (u - v)"
    signature = "phase grows in proportion to frequency, the gain rolls off"
    quantities: ClassVar[dict[str, Quantity]] = {"cutoff_hz": Quantity("Hz", at_least=1.0, at_most=1e6)}
    identity: ClassVar[Parameters] = {"cutoff_hz": math.inf}
    cutoff_hz: nn.Parameter

    def matrices(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The discrete block; its state is what is left of the voltage a sample later."""
        decay = torch.exp(-2 * math.pi * self.sample_period_s * self.cutoff_hz)
        fresh = 1 - decay
        return decay.reshape(1, 1), (decay * fresh).reshape(1), torch.ones_like(decay).reshape(1), fresh

    def initial_state(self, batch: int) -> Tensor:
        return torch.zeros(batch, 1, dtype=torch.float64)

    def forward(
        self,
        x: Tensor,  # (batch, time), V
        state: Tensor | None = None,  # (batch, 1), V
    ) -> tuple[Tensor, Tensor]:
        return state_space(x, *self.matrices(), self.initial_state(len(x)) if state is None else state)

    def stream(self) -> nn.Module:
        a, b, c, d = self.matrices()
        return LinearStream(a.flatten().tolist(), b.tolist(), c.tolist(), d.item())

    @classmethod
    def starts(cls, seen: Seen) -> list[Parameters]:
        # Above a third of the sample rate a held input shows no lag.
        return [{"cutoff_hz": f} for f in (16.0, 60.0, 200.0, 700.0, 2500.0, 9000.0) if f < seen.fs_hz / 3]
