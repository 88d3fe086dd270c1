"""A transport delay v(t) = u(t - τ): computation, converters, a slow bus.

With τ = (m + f) T the output is p u(k-m) + q u(k-m-1). If the signal is linear between samples, p = 1 - f and
q = f, which is exact for a ramp and gives τ a gradient. If the signal comes from a held command through the
amplifier's lag, of angular cutoff ω, it is exponential between samples:

    p = (1 - e^{-ω(1-f)T}) / (1 - e^{-ωT}),    q = 1 - p

Behind a lag of two poles, which leaves no corners, the signal is taken to be linear.
"""

import math
from collections.abc import Callable
from typing import ClassVar

import torch
from torch import Tensor, nn

from torchpi.errors import StageError
from torchpi.operators.delay import delay_line, delay_stream
from torchpi.operators.quantity import Quantity
from torchpi.stage.effects.effect import DataRange, LinearEffect, Parameters, parameter

LONGEST_S = 0.1  # longest delay in a fit
USUAL_S = 0.01  # length of the delay line for any shorter delay
MOST_SAMPLES = 1_000_000  # largest length of the delay line


class Delay(LinearEffect):
    """A delay, of up to 0.1 s in a fit. The state holds the last inputs, as many at any delay up to 10 ms.

    With `after_lag` 1 and an amplifier's lag of one pole before it in the chain, fractions of a sample are
    exact for a held command.
    """

    name = "delay"
    block = "amplifier"
    before_hysteresis = True
    equation = "v(t) = u(t - τ)"
    signature = "phase grows in proportion to frequency, the gain stays flat"
    time_scale = "fast"
    delays = True
    commutes = True
    delay_s: nn.Parameter = parameter("s", at_least=0.0, at_most=LONGEST_S)
    after_lag: nn.Parameter = parameter("", at_least=0.0, at_most=1.0)
    accepted: ClassVar[dict[str, Quantity]] = {"delay_s": Quantity("s", at_least=0.0)}
    kinds = ("after_lag",)
    decay: Callable[[Tensor], Tensor] | None = None
    """Share of the lagged voltage left after so many samples, if a lag of one pole precedes the delay."""

    def __init__(self, sample_period_s: float, **values: float) -> None:
        super().__init__(sample_period_s, **values)
        if not self.delay_s.item() / sample_period_s <= MOST_SAMPLES:
            raise StageError(
                f"delay_s: found {self.delay_s.item():g} s, "
                f"expected at most {MOST_SAMPLES * sample_period_s:g} s, {MOST_SAMPLES} samples"
            )

    def split(self) -> tuple[int, Tensor]:
        """Return the whole samples m and the fraction f, which has a gradient in the delay."""
        if not self.delay_s.item() >= 0:
            raise StageError(f"delay_s: found {self.delay_s.item():g} s, expected at least 0 s")
        samples = self.delay_s / self.sample_period_s
        whole = math.floor(samples.item())
        return whole, samples - whole

    def taps(self, fraction: Tensor) -> tuple[Tensor, Tensor]:
        """Return p and q."""
        if self.decay is None or self.after_lag.item() < 0.5:
            return 1 - fraction, fraction
        p = (1 - self.decay(1 - fraction)) / (1 - self.decay(torch.ones_like(fraction)))
        return p, 1 - p

    def initial_state(self, batch: int) -> Tensor:
        longest_s = max(USUAL_S, self.delay_s.item())
        return torch.zeros(batch, math.floor(longest_s / self.sample_period_s) + 2, dtype=torch.float64)

    def forward(
        self,
        x: Tensor,  # (batch, time), V
        state: Tensor | None = None,  # (batch, samples of the longest delay + 2), V
    ) -> tuple[Tensor, Tensor]:
        whole, fraction = self.split()
        line = self.initial_state(len(x)).to(x.device) if state is None else state
        return delay_line(x, line, whole, *self.taps(fraction))

    def stream(self) -> nn.Module:
        whole, fraction = self.split()
        p, q = self.taps(fraction)
        return delay_stream(whole, p.item(), q.item())

    @classmethod
    def later(cls, values: Parameters, by_s: float) -> Parameters | None:
        return {**values, "delay_s": values.get("delay_s", 0.0) + by_s}

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        longest_s = min(LONGEST_S, seen.duration_s / 10)
        tried = [samples / seen.fs_hz for samples in (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)]
        return [{"delay_s": delay_s} for delay_s in tried if delay_s < longest_s]
