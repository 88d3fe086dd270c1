"""Transport delay y(t) = u(t - τ), whole samples and the fraction between them.

With τ = (m + f) T, 0 ≤ f < 1, the output is two taps on a line of past inputs, p u(k-m) + q u(k-m-1):
f says how the newer and the older tap share. What p and q are depends on what the input does between
samples; here it runs straight from one to the next, so p = 1 - f, q = f. For an input that a converter
holds, see `held_lag`.
"""

import math
from typing import ClassVar

import torch
from torch import Tensor, nn

from torchpi.errors import StageError
from torchpi.operators.base import Operator
from torchpi.operators.quantity import Quantity

DELAY = Quantity("s", at_least=0)


def two_taps(newer: float, older: float, p: float, q: float) -> float:
    """p u(k-m) + q u(k-m-1). Tensors pass as well."""
    return p * newer + q * older


class DelayLine(Operator):
    """A line of past inputs, long enough for any delay up to `longest_delay_s`; subclasses give the taps.

    The state holds the last inputs, oldest first: (batch, samples of the longest delay + 2).

    Args:
        sample_period_s: T.
        delay_s: τ, trainable: it has a gradient through the fraction, and passes whole samples freely.
        longest_delay_s: Largest τ that training may reach; by default twice the delay, 20 samples at least.

    Raises:
        StageError: A negative delay; in use, one that has left 0 … `longest_delay_s`.
    """

    quantities: ClassVar[dict[str, Quantity]] = {"delay_s": DELAY, "longest_delay_s": DELAY}

    def __init__(self, sample_period_s: float, delay_s: float, longest_delay_s: float | None = None) -> None:
        super().__init__()
        self.sample_period_s = sample_period_s
        self.delay_s = DELAY.parameter("delay_s", delay_s)
        if longest_delay_s is None:
            longest_delay_s = max(2 * delay_s, 20 * sample_period_s)
        self.longest_delay_s = DELAY.check("longest_delay_s", longest_delay_s)
        self.split()

    def taps(self, fraction: Tensor) -> tuple[Tensor, Tensor]:
        """p and q for f, the fraction of a sample."""
        raise TypeError(f"{type(self).__name__} must define taps(fraction)")

    def split(self) -> tuple[int, Tensor]:
        """Whole samples m, and the fraction f with its gradient to the delay."""
        found = self.delay_s.item()
        if not 0 <= found <= self.longest_delay_s:
            longest = f"longest_delay_s = {self.longest_delay_s:g} s"
            raise StageError(f"delay_s: found {found:g} s, want 0 to {longest}")
        samples = self.delay_s / self.sample_period_s
        whole = math.floor(samples.item())
        return whole, samples - whole

    def initial_state(self, batch: int) -> Tensor:
        length = math.floor(self.longest_delay_s / self.sample_period_s) + 2
        return torch.zeros(batch, length, dtype=torch.float64)

    def forward(
        self,
        x: Tensor,  # (batch, time)
        state: Tensor | None = None,  # (batch, line)
    ) -> tuple[Tensor, Tensor]:
        line = self.initial_state(len(x)).to(x.device) if state is None else state
        whole, fraction = self.split()
        p, q = (tap.to(x.device) for tap in self.taps(fraction))
        past = torch.cat([line, x.to(line.dtype)], 1)
        newest = line.shape[1] - whole
        y = two_taps(
            past[:, newest : newest + x.shape[1]],  # type: ignore[arg-type]
            past[:, newest - 1 : newest - 1 + x.shape[1]],  # type: ignore[arg-type]
            p,  # type: ignore[arg-type]
            q,  # type: ignore[arg-type]
        )
        return y.to(x.dtype), past[:, x.shape[1] :]  # type: ignore[attr-defined]

    def stream(self) -> nn.Module:
        whole, fraction = self.split()
        p, q = self.taps(fraction)
        return DelayLineStream(whole, p.item(), q.item())

    def extra_repr(self) -> str:
        return f"delay {self.delay_s.item():g} s"


class Delay(DelayLine):
    """A delay anywhere in the chain, exact for a signal that runs straight from sample to sample."""

    def taps(self, fraction: Tensor) -> tuple[Tensor, Tensor]:
        return 1 - fraction, fraction


class DelayLineStream(nn.Module):
    """The line, one sample at a time: a ring of the last inputs."""

    ring: list[float]

    def __init__(self, whole: int, p: float, q: float) -> None:
        super().__init__()
        self.whole = whole
        self.p = p
        self.q = q
        self.ring = [0.0] * (whole + 2)
        self.at = 0

    @torch.jit.export
    def reset(self) -> None:
        for i in range(len(self.ring)):
            self.ring[i] = 0.0

    @torch.jit.export
    def step(self, u: float) -> float:
        size = len(self.ring)
        self.ring[self.at] = u
        newer = self.ring[(self.at + size - self.whole) % size]
        older = self.ring[(self.at + size - self.whole - 1) % size]
        self.at = (self.at + 1) % size
        return two_taps(newer, older, self.p, self.q)
