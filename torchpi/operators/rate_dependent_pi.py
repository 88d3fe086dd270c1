"""The rate-dependent Prandtl–Ishlinskii operator: eq. 3 with weights that follow the rate of its own input.

    y(t) = Σ_i w_i(u̇) H_ri[u](t),   w(u̇) = k u̇ + b

Ang, Garmón, Khosla and Riviere, IROS 2003; Ang, Khosla and Riviere, IEEE/ASME Trans. Mechatronics 12(2),
2007; Tan, Latt, Shee, Riviere and Ang, 2009. The plant of Fig. 7 in Qin et al. (2013), with the signed rate.
"""

import math
from typing import Any

import torch
from torch import Tensor, nn

from torchpi.errors import ConfigError
from torchpi.operators.base import Operator
from torchpi.operators.motion import BackwardMotionStream, backward_rate
from torchpi.operators.play import PlayBank
from torchpi.operators.weighted_sum import weight, weighted_sum

RATE_STATES = 3  # the two last inputs, and whether there was one


class RateDependentPI(Operator):
    """A forward hysteresis whose weights are linear in the signed rate of its input.

    The rate is the three-point backward difference, as of a signal that rested at its first value before the
    record. State: the plays, then the memory of the rate.

    Args:
        sample_period_s: T.
        thresholds: r, unit of the input, none negative.
        slopes: k, one a threshold, change of the weight per unit of rate.
        offsets: b, the weights at rest.

    Raises:
        ConfigError: Bad thresholds, a number that is not finite, another number of slopes or offsets than of
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
        """The same with a rate that is known, of an input that is a formula for instance."""
        h, state = self.plays(x, state)
        basis = torch.stack([torch.ones_like(rate), rate], -1)
        return weighted_sum(h, basis, torch.stack([self.b, self.k], 1).to(x.dtype)), state

    def stream(self) -> "RateDependentPIStream":
        law = WeightedPlaysStream(self.plays.stream(), self.b, self.k)
        return RateDependentPIStream(law, BackwardMotionStream(self.sample_period_s))

    def extra_repr(self) -> str:
        return f"T = {self.sample_period_s:g} s"


class WeightedPlaysStream(nn.Module):
    """Σ_i (b_i + k_i ẋ) h_i over any bank of plays, one sample at a time, at a rate that is given.

    Args:
        plays: Stream of the bank, whose `step(x)` returns the list of its states.
        b: Weights at rest, one a play.
        k: Change of the weights with the rate.
    """

    theta: list[float]
    basis: list[float]

    def __init__(self, plays: Any, b: Tensor, k: Tensor) -> None:
        super().__init__()
        self.plays = plays
        self.theta = torch.stack([b, k], 1).flatten().tolist()
        self.basis = [1.0, 0.0]

    @torch.jit.export
    def reset(self) -> None:
        self.plays.reset()

    @torch.jit.export
    def step(self, x: float, rate: float, acceleration: float) -> float:
        self.basis[1] = rate
        h: list[float] = self.plays.step(x)
        total = 0.0
        for i in range(len(h)):
            total += weight(self.theta, self.basis, i) * h[i]
        return total


class RateDependentPIStream(nn.Module):
    """The operator, one sample at a time."""

    def __init__(self, law: WeightedPlaysStream, motion: BackwardMotionStream) -> None:
        super().__init__()
        self.law = law
        self.motion = motion

    @torch.jit.export
    def reset(self) -> None:
        self.law.reset()
        self.motion.reset()

    @torch.jit.export
    def step(self, x: float) -> float:
        _, rate, _ = self.motion.step(x)
        return self.law.step(x, rate, 0.0)


def own_rate(
    x: Tensor,  # (batch, time)
    memory: Tensor,  # (batch, RATE_STATES): x one sample ago, x two samples ago, 1 once there was a sample
    sample_period_s: float,
) -> tuple[Tensor, Tensor]:  # (batch, time), (batch, RATE_STATES)
    """The causal rate of a signal, and the memory of it after the last sample."""
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
