"""Compiled FIR filters over windows; each sum runs from the oldest sample to the newest.

The transposed form of an exported step sums in the same order and thus gives the same bits.
"""

import numpy as np

from torchpi.operators.compiled import njit


@njit
def filter_matrix(
    x: np.ndarray,  # (taps - 1 + time, inputs), of which the first are samples before the window
    taps: np.ndarray,  # (taps, outputs, inputs), that of the newest sample first
    y: np.ndarray,  # (time, outputs), written
) -> None:
    """Compute y(t) = Σ_j H_j x(t - j), a matrix of filters."""
    length, outputs, inputs = taps.shape
    for t in range(len(y)):
        for o in range(outputs):
            y[t, o] = 0.0
        for j in range(length):
            for o in range(outputs):
                for i in range(inputs):
                    y[t, o] += taps[length - 1 - j, o, i] * x[t + j, i]


@njit
def interpolate(
    x: np.ndarray,  # (before + time, channels), of which the first are samples before the window
    taps: np.ndarray,  # (factor before + 1,), at the higher rate
    factor: int,
    y: np.ndarray,  # (factor time, channels), written
) -> None:
    """Insert zeros between samples and apply a low-pass at `factor` times the rate."""
    before = (len(taps) - 1) // factor
    for n in range(len(y)):
        phase, newest = n % factor, before + n // factor
        for c in range(x.shape[1]):
            y[n, c] = 0.0
        for k in range(newest - (len(taps) - 1 - phase) // factor, newest + 1):
            tap = taps[phase + factor * (newest - k)]
            for c in range(x.shape[1]):
                y[n, c] += tap * x[k, c]


@njit
def decimate(
    x: np.ndarray,  # (taps - 1 + factor time, channels), of which the first are before the window
    taps: np.ndarray,  # (taps,)
    factor: int,
    y: np.ndarray,  # (time, channels), written
) -> None:
    """Apply a low-pass and keep the first of every `factor` samples."""
    last = len(taps) - 1
    for t in range(len(y)):
        for c in range(x.shape[1]):
            y[t, c] = 0.0
        for k in range(len(taps)):
            tap = taps[last - k]
            for c in range(x.shape[1]):
                y[t, c] += tap * x[factor * t + k, c]
