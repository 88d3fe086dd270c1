"""A voltage that was monitored has noise of its own, which never drove the stage.

Left there, it is a reason for any lag in front of the hysteresis: a filter of the noise predicts better than
the noise (errors in variables: Söderström, *Errors-in-Variables Methods in System Identification*, 2018).
"""

import numpy as np
from scipy.signal import savgol_filter

from torchpi.recordings.faults import robust_sd

SMALLEST, LARGEST = 1e-6, 0.005
"""Of the span: what scatters less is the rounding of a file, what scatters more is a command."""
OF_WHITE = (-0.8, 0.4)
"""Autocorrelations of the fourth differences of white noise, at one and two samples."""
WITHIN = 0.03
"""Of these: those of integrated white noise, -0.75 and 0.3, are farther away."""
WINDOWS = tuple(2**k + 1 for k in range(2, 9))
"""Samples of a local parabola."""
SURE = 2.5
"""Standard deviations of a local estimate within which those of smaller windows lie."""


def without_noise(u: np.ndarray) -> np.ndarray:
    """(time,), V: each sample on the longest local parabola that no shorter one contradicts.

    A command comes back as it is.

    The windows are chosen by intersection of confidence intervals (Goldenshluger and Nemirovski,
    *Mathematical Methods of Statistics* 6, 1997): edges and corners stay where they are.
    """
    sd = noise_of(u)
    if sd == 0.0:
        return u
    smooth, going = u.copy(), np.ones(len(u), dtype=bool)
    low, high = u - SURE * sd, u + SURE * sd
    for window in WINDOWS:
        if window > len(u):
            break
        impulse = np.zeros(window)
        impulse[window // 2] = 1.0
        kernel = savgol_filter(impulse, window, 2)
        half = SURE * sd * float(np.sqrt(kernel @ kernel))
        estimate = savgol_filter(u, window, 2)
        low, high = np.maximum(low, estimate - half), np.minimum(high, estimate + half)
        going &= low <= high
        smooth[going] = estimate[going]
    return smooth


def noise_of(u: np.ndarray) -> float:
    """Standard deviation of the white noise of a monitored voltage, (time,), V; 0 for a command."""
    span = float(np.ptp(u))
    bent = np.diff(u, 4)
    if len(bent) < max(WINDOWS) or span == 0.0:
        return 0.0
    scatter = float(robust_sd(bent))
    sd = scatter / np.sqrt(70.0)  # the sum of the squares of 1, 4, 6, 4, 1
    if not SMALLEST * span < sd < LARGEST * span:
        return 0.0
    bent = np.clip(bent, -5 * scatter, 5 * scatter)
    size = float(bent @ bent)
    for k, expected in enumerate(OF_WHITE, 1):
        if abs(float(bent[k:] @ bent[:-k]) / size - expected) > WITHIN:
            return 0.0
    return float(sd)
