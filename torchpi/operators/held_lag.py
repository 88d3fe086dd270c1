"""What a converter and an amplifier make of a sampled command: held, delayed, lagged.

The command u(k) is written at tick k and held to tick k+1. The amplifier answers v̇ = ω(u(t - τ) - v),
ω = 2πf_c. With τ = (m + f) T the step from u(k-m-1) to u(k-m) arrives f T after tick k, so

    v(k+1) = e^{-ωT} v(k) + (1 - e^{-ω(1-f)T}) u(k-m) + (e^{-ω(1-f)T} - e^{-ωT}) u(k-m-1)

exactly. v(k) is what stands there just before u(k) is written: it depends on u up to k-1, also for an
ideal amplifier, whose v(k) is u(k-1).
"""

import math
from typing import ClassVar

import torch
from torch import Tensor, nn

from torchpi.operators.delay import DelayLine, DelayLineStream
from torchpi.operators.lag import CUTOFF
from torchpi.operators.linear import LinearStream, state_space
from torchpi.operators.quantity import Quantity


class HeldLag(DelayLine):
    """Command (held) to the voltage just before the next command.

    The state holds v, then the line of past commands.

    Args:
        sample_period_s: T.
        cutoff_hz: f_c; None for an ideal amplifier, whose fractional delay is then that of a ramp.
        delay_s: τ, computation and converter together.
        longest_delay_s: Largest τ that training may reach; as in `DelayLine`.

    Raises:
        StageError: A cutoff that is not positive, or a negative delay.
    """

    quantities: ClassVar[dict[str, Quantity]] = {**DelayLine.quantities, "cutoff_hz": CUTOFF}

    def __init__(
        self,
        sample_period_s: float,
        cutoff_hz: float | None = None,
        delay_s: float = 0.0,
        longest_delay_s: float | None = None,
    ) -> None:
        super().__init__(sample_period_s, delay_s, longest_delay_s)
        self.cutoff_hz: nn.Parameter | None
        self.register_parameter(
            "cutoff_hz", None if cutoff_hz is None else CUTOFF.parameter("cutoff_hz", cutoff_hz)
        )

    def decay(self, samples: Tensor) -> Tensor:
        """e^{-ω · samples · T}: what is left of a voltage after that time; nothing, if ideal."""
        if self.cutoff_hz is None:
            return torch.zeros_like(samples)
        return torch.exp(-2 * math.pi * self.cutoff_hz * self.sample_period_s * samples)

    def taps(self, fraction: Tensor) -> tuple[Tensor, Tensor]:
        if self.cutoff_hz is None:
            return 1 - fraction, fraction
        after_step = self.decay(1 - fraction)
        return 1 - after_step, after_step - self.decay(torch.ones_like(fraction))

    def initial_state(self, batch: int) -> Tensor:
        return torch.cat([torch.zeros(batch, 1, dtype=torch.float64), super().initial_state(batch)], 1)

    def forward(
        self,
        x: Tensor,  # (batch, time), V
        state: Tensor | None = None,  # (batch, 1 + line), V
    ) -> tuple[Tensor, Tensor]:
        before = self.initial_state(len(x)).to(x.device) if state is None else state
        driven, line = super().forward(x, before[:, 1:])
        one, zero = torch.ones_like(self.delay_s).reshape(1), torch.zeros_like(self.delay_s)
        v, last = state_space(driven, self.decay(one).reshape(1, 1), one, one, zero, before[:, :1])
        return v, torch.cat([last, line], 1)

    def stream(self) -> nn.Module:
        whole, fraction = self.split()
        p, q = self.taps(fraction)
        decay = self.decay(torch.ones_like(fraction))
        return HeldLagStream(
            DelayLineStream(whole, p.item(), q.item()), LinearStream([decay.item()], [1.0], [1.0], 0.0)
        )

    def extra_repr(self) -> str:
        cutoff = "ideal" if self.cutoff_hz is None else f"cutoff {self.cutoff_hz.item():g} Hz"
        return f"{cutoff}, {super().extra_repr()}"


class HeldLagStream(nn.Module):
    """The amplifier, one sample at a time: takes u(k), returns v(k)."""

    def __init__(self, line: DelayLineStream, lag: LinearStream) -> None:
        super().__init__()
        self.line = line
        self.lag = lag

    @torch.jit.export
    def reset(self) -> None:
        self.line.reset()
        self.lag.reset()

    @torch.jit.export
    def step(self, u: float) -> float:
        return self.lag.step(self.line.step(u))
