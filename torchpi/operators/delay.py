"""A line of past inputs that is read between two of them: p u(k-m) + q u(k-m-1).

A delay of (m + f) T, 0 ≤ f < 1, reads m samples back; what p and q are depends on what the signal does
between samples. `torchpi.stage.effects.amplifier.delay` has both cases.
"""

import torch
from torch import Tensor, nn


def two_taps(newer: float, older: float, p: float, q: float) -> float:
    """p u(k-m) + q u(k-m-1). Tensors pass as well."""
    return p * newer + q * older


def delay_line(
    x: Tensor,  # (batch, time)
    line: Tensor,  # (batch, m + 1 or more): the last inputs, oldest first
    whole: int,  # m
    p: Tensor,  # ()
    q: Tensor,  # ()
) -> tuple[Tensor, Tensor]:  # (batch, time), and the line after the last sample
    """Whole records through the line; differentiable in everything but m."""
    past = torch.cat([line, x.to(line.dtype)], 1)
    newest, time = line.shape[1] - whole, x.shape[1]
    newer, older = past[:, newest : newest + time], past[:, newest - 1 : newest - 1 + time]
    y: Tensor = two_taps(newer, older, p.to(x.device), q.to(x.device))  # type: ignore
    return y.to(x.dtype), past[:, time:]


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
