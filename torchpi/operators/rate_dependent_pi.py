"""The rate-dependent Prandtl–Ishlinskii operator: eq. 3 with weights that follow the rate of its own input.

    y(t) = Σ_i w_i(u̇) H_ri[u](t),   w(u̇) = k u̇ + b

Ang, Garmón, Khosla and Riviere, IROS 2003; Ang, Khosla and Riviere, IEEE/ASME Trans. Mechatronics 12(2),
2007; Tan, Latt, Shee, Riviere and Ang, 2009. The plant of Fig. 7 in Qin et al. (2013), with the signed rate.
"""

import math

import torch
from torch import Tensor, nn

from torchpi.errors import ConfigError
from torchpi.operators.base import Operator, StepStream
from torchpi.operators.motion import backward_rate
from torchpi.operators.play import PlayBank, play
from torchpi.operators.weighted_sum import weighted_sum

RATE_STATES = 3  # the last two inputs, and whether there was any


class RateDependentPI(Operator):
    """A forward hysteresis whose weights are linear in the signed rate of its input.

    The rate is the three-point backward difference; before the record the input is taken to have rested at
    its first value. The state consists of the plays, then the memory of the rate.

    Args:
        sample_period_s: T.
        thresholds: r, unit of the input, none negative.
        slopes: k, one per threshold, change of the weight per unit of rate.
        offsets: b, the weights at rest.

    Raises:
        ConfigError: Invalid thresholds, a number that is not finite, not as many slopes or offsets as
            thresholds, or a period that is not positive.
    """

    def __init__(
        self,
        sample_period_s: float,
        thresholds: list[float],
        slopes: list[float],
        offsets: list[float],
    ) -> None:
        super().__init__()
        if not 0 < sample_period_s < math.inf:
            raise ConfigError(f"sample_period_s: found {sample_period_s}, expected a positive number of s")
        self.sample_period_s = sample_period_s
        self.plays = PlayBank(thresholds)
        for name, values in (("slopes", slopes), ("offsets", offsets)):
            if len(values) != len(thresholds) or not all(map(math.isfinite, values)):
                raise ConfigError(
                    f"{name}: found {list(values)}, expected {len(thresholds)} finite numbers, "
                    "one a threshold"
                )
        self.k = nn.Parameter(torch.as_tensor(slopes, dtype=torch.float64).clone())
        self.b = nn.Parameter(torch.as_tensor(offsets, dtype=torch.float64).clone())

    def initial_state(self, batch: int) -> Tensor:
        return torch.zeros(batch, len(self.k) + RATE_STATES, dtype=torch.float64)

    def forward(
        self,
        x: Tensor,  # (batch, time)
        state: Tensor | None = None,  # (batch, plays + rate memory)
    ) -> tuple[Tensor, Tensor]:
        state = self.initial_state(len(x)).to(x.device, x.dtype) if state is None else state
        h0, memory = state.split([len(self.k), RATE_STATES], 1)
        rate, memory = own_rate(x, memory, self.sample_period_s)
        y, h0 = self.at_rate(x, rate, h0)
        return y, torch.cat([h0, memory], 1)

    def at_rate(
        self,
        x: Tensor,  # (batch, time)
        rate: Tensor,  # (batch, time), unit of x per s
        state: Tensor | None = None,  # (batch, plays)
    ) -> tuple[Tensor, Tensor]:
        """Apply the operator with a known rate, for instance of an input given by a formula."""
        h, state = self.plays(x, state)
        basis = torch.stack([torch.ones_like(rate), rate], -1)
        return weighted_sum(h, basis, torch.stack([self.b, self.k], 1).to(x.dtype)), state

    def stream(self) -> StepStream:
        numbers = torch.cat([self.plays.r, self.b, self.k]).tolist()
        return StepStream(rate_dependent_step, [self.sample_period_s, *numbers], len(self.k) + RATE_STATES)

    def extra_repr(self) -> str:
        return f"T = {self.sample_period_s:g} s"


def rate_dependent_step(x: float, n: list[float], s: list[float]) -> float:
    """One step in the form a stream calls: n holds T, r, b and k; s holds the state."""
    rate = own_rate_step(x, n[0], s)
    plays, total = len(s) - 3, 0.0
    for i in range(plays):
        s[i] = play(x, n[1 + i], s[i])
        total += (n[1 + plays + i] + n[1 + 2 * plays + i] * rate) * s[i]
    return total


def own_rate_step(x: float, sample_period_s: float, s: list[float]) -> float:
    """`own_rate` for one sample, with its memory in the last entries of `s`."""
    at = len(s) - 3
    if s[at + 2] == 0.0:
        s[at] = x
        s[at + 1] = x
        s[at + 2] = 1.0
    rate = backward_rate(x, s[at], s[at + 1], sample_period_s)
    s[at + 1] = s[at]
    s[at] = x
    return rate


def own_rate(
    x: Tensor,  # (batch, time)
    memory: Tensor,  # (batch, RATE_STATES): x one sample ago, x two samples ago, 1 once there was a sample
    sample_period_s: float,
) -> tuple[Tensor, Tensor]:  # (batch, time), (batch, RATE_STATES)
    """Return the causal rate of a signal, and the rate memory after the last sample."""
    started = memory[:, 2:] > 0.5
    first = x[:, :1]
    y1 = torch.where(started, memory[:, :1].to(x.dtype), first)
    y2 = torch.where(started, memory[:, 1:2].to(x.dtype), first)
    held = torch.cat([y2, y1, x], 1)
    rate = backward_rate(
        x,  # type: ignore[arg-type]
        held[:, 1:-1],  # type: ignore[arg-type]
        held[:, :-2],  # type: ignore[arg-type]
        sample_period_s,
    )
    last = torch.stack([held[:, -1], held[:, -2], torch.ones_like(held[:, -1])], 1)
    return rate, last  # type: ignore[return-value]
