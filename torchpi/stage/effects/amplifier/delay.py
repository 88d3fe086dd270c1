"""A transport delay v(t) = u(t - τ): computation, converters, a slow bus.

The signal runs straight from sample to sample, which makes the fraction of a sample exact, and gives τ a
gradient.
"""

from typing import ClassVar

from torch import Tensor, nn
from torch.func import functional_call

from torchpi.operators.delay import Delay as DelayOperator
from torchpi.operators.quantity import Quantity
from torchpi.stage.effects.effect import LinearEffect, Parameters, Seen

LONGEST_S = 0.01


class Delay(LinearEffect):
    """A delay of up to 10 ms. The state holds the last inputs, as many at any delay."""

    name = "delay"
    block = "amplifier"
    before_hysteresis = True
    equation = "v(t) = u(t - τ)"
    signature = "phase grows in proportion to frequency, the gain stays flat"
    time_scale = "fast"
    delays = True
    quantities: ClassVar[dict[str, Quantity]] = {"delay_s": Quantity("s", at_least=0.0, at_most=LONGEST_S)}
    identity: ClassVar[Parameters] = {"delay_s": 0.0}
    delay_s: nn.Parameter

    def operator(self) -> DelayOperator:
        """The delay line at the present value."""
        return DelayOperator(self.sample_period_s, self.delay_s.item(), LONGEST_S)

    def initial_state(self, batch: int) -> Tensor:
        return self.operator().initial_state(batch)

    def forward(
        self,
        x: Tensor,  # (batch, time), V
        state: Tensor | None = None,  # (batch, samples of the longest delay + 2), V
    ) -> tuple[Tensor, Tensor]:
        return functional_call(self.operator(), {"delay_s": self.delay_s}, (x, state))  # type: ignore[no-any-return]

    def stream(self) -> nn.Module:
        return self.operator().stream()

    @classmethod
    def starts(cls, seen: Seen) -> list[Parameters]:
        longest = min(LONGEST_S, seen.duration_s / 10)
        tried = (5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3)
        return [{"delay_s": delay_s} for delay_s in tried if delay_s < longest]
