"""What an amplifier and an actuator add to a band-limited voltage, taken between its samples.

Sampled at little more than twice its highest frequency, a signal turns between samples: plays of the
samples alone miss how far it went. So the input is interpolated, what it causes is taken at the higher rate,
and low-passed back to the rate of the samples. Both filters are of linear phase: the result knows
`LOOKAHEAD` samples to come.
"""

import numpy as np
from scipy.signal import bilinear, firwin, lfilter, upfirdn

from torchpi.operators.relaxing_play import relaxing_plays

FACTOR = 4
HALF_LENGTH = 40
"""Of the filter, in samples of the input: at 0.94 of the Nyquist frequency it still passes."""
LOOKAHEAD = 2 * HALF_LENGTH
TAPS = firwin(2 * FACTOR * HALF_LENGTH + 1, 1.0 / FACTOR, window=("kaiser", 6.0))


def play_excess(u: np.ndarray, thresholds: np.ndarray, rates_hz: np.ndarray, rate_hz: float) -> np.ndarray:
    """h - u of relaxing plays, low-passed, from rest.

    Args:
        u: (time, inputs).
        thresholds: r, (plays,), in the unit of u.
        rates_hz: ω / 2π, Hz, (plays,).
        rate_hz: Sample rate of u, Hz.

    Returns:
        (time, inputs, plays).
    """
    if len(thresholds) == 0:
        return np.zeros((*u.shape, 0))
    x = np.ascontiguousarray(_interpolated(u).T)  # (inputs, fine time)
    h = np.empty((*x.shape, len(thresholds)))
    relaxing_plays(x, thresholds, np.exp(-2 * np.pi * rates_hz / (FACTOR * rate_hz)), h)
    h -= x[..., None]
    return _decimated(h.swapaxes(0, 1))


def crossover(u: np.ndarray, widths: np.ndarray, corner_hz: float, rate_hz: float) -> np.ndarray:
    """Crossover distortion of the amplifier, low-passed, from rest.

    The current into a piezo actuator follows the slope of its voltage v. An output stage of class B loses
    some of its voltage where the current changes sign, and the amplifier's loop takes back what of that
    lies below its bandwidth ω (Self, Audio Power Amplifier Design, 2013, ch. 9):

        v̇ = ω (u - v),   e = s/(s + ω) tanh(v̇/w)

    Where the signs change at another current than zero, there is some of tanh² as well.

    Args:
        u: (time, inputs), V.
        widths: w, V/s, (widths,).
        corner_hz: ω / 2π, Hz.
        rate_hz: Sample rate of u, Hz.

    Returns:
        (time, inputs, 2 widths): those of tanh, then those of tanh².
    """
    if len(widths) == 0:
        return np.zeros((*u.shape, 0))
    omega = 2 * np.pi * corner_hz
    high_pass = bilinear([1.0, 0.0], [1.0, omega], FACTOR * rate_hz)
    slope = omega * lfilter(*high_pass, _interpolated(u), axis=0)
    odd = np.tanh(slope[..., None] / widths)
    return _decimated(lfilter(*high_pass, np.concatenate([odd, odd**2], 2), axis=0))


def _interpolated(u: np.ndarray) -> np.ndarray:
    """(fine time, inputs)."""
    late = FACTOR * HALF_LENGTH
    fine: np.ndarray = upfirdn(FACTOR * TAPS, u, up=FACTOR, axis=0)[late : late + FACTOR * len(u)]
    return fine


def _decimated(fine: np.ndarray) -> np.ndarray:
    """(time, …) of (fine time, …)."""
    padded = np.concatenate([fine, np.zeros((FACTOR * HALF_LENGTH, *fine.shape[1:]))])
    low = upfirdn(TAPS, padded, down=FACTOR, axis=0)[HALF_LENGTH : HALF_LENGTH + len(fine) // FACTOR]
    return np.ascontiguousarray(low)
