"""Resampling of a signal to another rate, without aliasing and without delay."""

from fractions import Fraction

import numpy as np


def to_rate(x: np.ndarray, from_hz: float, to_hz: float, samples: int) -> np.ndarray:
    """Resample by a polyphase filter if the ratio has small integers, else by low-pass and cubic spline.

    Both ends are extended by point reflection, so that an offset or a slope causes no transient there.
    """
    from scipy.signal import resample_poly

    ratio = Fraction(to_hz / from_hz).limit_denominator(2000)
    margin = min(len(x) - 1, int(np.ceil(40 * max(1.0, from_hz / to_hz))))
    if abs(ratio * from_hz / to_hz - 1) > 1e-9 or ratio.numerator > 2000:
        return _resample_any(x, from_hz, to_hz, samples, margin)
    up, down = ratio.numerator, ratio.denominator
    margin = min(len(x) - 1, -(-margin // down) * down)
    margin -= margin % down  # keeps the first sample on the new grid
    extended = _reflected(x, margin)
    first = margin * up // down
    converted = resample_poly(extended, up, down, padtype="line", window=("kaiser", 10.0))
    return np.asarray(converted[first : first + samples])


def _resample_any(x: np.ndarray, from_hz: float, to_hz: float, samples: int, margin: int) -> np.ndarray:
    from scipy.interpolate import CubicSpline
    from scipy.signal import butter, sosfiltfilt

    extended = _reflected(x, margin)
    if to_hz < from_hz:
        extended = sosfiltfilt(butter(8, 0.8 * to_hz / from_hz, output="sos"), extended)
    spline = CubicSpline(np.arange(len(extended)) - margin, extended)
    return np.asarray(spline(np.arange(samples) * (from_hz / to_hz)))


def _reflected(x: np.ndarray, margin: int) -> np.ndarray:
    if margin <= 0:
        return x
    return np.concatenate((2 * x[0] - x[margin:0:-1], x, 2 * x[-1] - x[-2 : -margin - 2 : -1]))
