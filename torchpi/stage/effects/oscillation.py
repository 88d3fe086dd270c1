"""A line in absolute time, a cos 2πft + b sin 2πft, t from the first sample, however the stage moves."""

import math
from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor

from torchpi.stage.effects.added_signal import sampled


def oscillation(t_s: float, frequency_hz: float, cos: float, sin: float) -> float:
    """Return a cos φ + b sin φ, φ = 2πft. Kernel and streams compile this."""
    phase = 2.0 * math.pi * frequency_hz * t_s
    return cos * math.cos(phase) + sin * math.sin(phase)


def oscillation_of_tensors(t_s: Tensor, frequency_hz: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """`oscillation` of tensors, used only for the gradients."""
    phase = 2 * math.pi * frequency_hz * t_s
    return cos * torch.cos(phase) + sin * torch.sin(phase)


def oscillations(
    elapsed: Tensor,  # (batch, 1), samples elapsed before the first one
    time: int,
    period_s: float,
    frequency_hz: Tensor,  # ()
    cos: Tensor,  # ()
    sin: Tensor,  # ()
) -> Tensor:  # (batch, time)
    """Return the line at `time` samples, differentiable in the state and in all three parameters."""
    parameters = (frequency_hz, cos, sin)
    return sampled(fill_line, oscillation_of_tensors, elapsed, time, period_s, parameters)


_oscillation: Any = numba.njit(oscillation)


@numba.njit(cache=True)
def fill_line(
    elapsed: np.ndarray, period_s: float, frequency_hz: float, cos: float, sin: float, line: np.ndarray
) -> None:
    """Fill `line`, (batch, time), which begins after `elapsed` samples."""
    for batch in range(line.shape[0]):
        for k in range(line.shape[1]):
            line[batch, k] = _oscillation((elapsed[batch] + k) * period_s, frequency_hz, cos, sin)
