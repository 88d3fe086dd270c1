"""A delay line that is read between two past inputs: p u(k-m) + q u(k-m-1).

A delay of (m + f) T, 0 ≤ f < 1, reads m samples back; p and q depend on how the signal behaves between
samples. `torchpi.stage.effects.amplifier.delay` covers both cases.
"""

import torch
from torch import Tensor

from torchpi.operators.base import StepStream


def two_taps(newer: float, older: float, p: float, q: float) -> float:
    """Return p u(k-m) + q u(k-m-1). Also for tensors."""
    return p * newer + q * older


def delay_line(
    x: Tensor,  # (batch, time)
    line: Tensor,  # (batch, m + 1 or more): the last inputs, oldest first
    whole: int,  # m
    p: Tensor,  # ()
    q: Tensor,  # ()
) -> tuple[Tensor, Tensor]:  # (batch, time), and the line after the last sample
    """Pass whole records through the line; differentiable in everything but m."""
    past = torch.cat([line, x.to(line.dtype)], 1)
    newest, time = line.shape[1] - whole, x.shape[1]
    newer, older = past[:, newest : newest + time], past[:, newest - 1 : newest - 1 + time]
    y: Tensor = two_taps(newer, older, p.to(x.device), q.to(x.device))  # type: ignore
    return y.to(x.dtype), past[:, time:]


def delay_step(x: float, n: list[float], s: list[float]) -> float:
    """One step in the form a stream calls: n holds m, p, q; s a ring of the last inputs and its position."""
    size, whole = len(s) - 1, int(n[0])
    at = int(s[size])
    s[at] = x
    newer = s[(at + size - whole) % size]
    older = s[(at + size - whole - 1) % size]
    s[size] = float((at + 1) % size)
    return two_taps(newer, older, n[1], n[2])


def delay_stream(whole: int, p: float, q: float) -> StepStream:
    """Return the line as a stream, one sample at a time."""
    return StepStream(delay_step, [whole, p, q], whole + 3)
