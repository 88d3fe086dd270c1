"""A line in absolute time, a cos 2πft + b sin 2πft, t from the first sample, whatever the stage does."""

import math
from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor

from torchpi.stage.effects.added_signal import sampled


def oscillation(t_s: float, frequency_hz: float, cos: float, sin: float) -> float:
    """a cos φ + b sin φ, φ = 2πft. Kernel and streams compile this."""
    phase = 2.0 * math.pi * frequency_hz * t_s
    return cos * math.cos(phase) + sin * math.sin(phase)


def oscillation_of_tensors(t_s: Tensor, frequency_hz: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """`oscillation`, which serves only the gradients."""
    phase = 2 * math.pi * frequency_hz * t_s
    return cos * torch.cos(phase) + sin * torch.sin(phase)


def oscillations(
    elapsed: Tensor,  # (batch, 1), samples before the first of these
    time: int,
    period_s: float,
    frequency_hz: Tensor,  # ()
    cos: Tensor,  # ()
    sin: Tensor,  # ()
) -> Tensor:  # (batch, time)
    """The line at `time` samples; differentiable in the state and in all three parameters."""
    parameters = (frequency_hz, cos, sin)
    return sampled(fill_line, oscillation_of_tensors, elapsed, time, period_s, parameters)


_oscillation: Any = numba.njit(oscillation)


@numba.njit(cache=True)
def fill_line(
    elapsed: np.ndarray, period_s: float, frequency_hz: float, cos: float, sin: float, line: np.ndarray
) -> None:
    """The kernel: `line`, (batch, time), from `elapsed` samples on."""
    for batch in range(line.shape[0]):
        for k in range(line.shape[1]):
            line[batch, k] = _oscillation((elapsed[batch] + k) * period_s, frequency_hz, cos, sin)
