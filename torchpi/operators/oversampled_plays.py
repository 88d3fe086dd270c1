"""Plays of a band-limited input between its samples.

Sampled at little more than twice its highest frequency, a signal turns between samples: plays of the
samples alone miss how far it went. So the input is interpolated, the plays taken at the higher rate, and what
they add low-passed back to the rate of the samples. Both filters are of linear phase: the result knows
`LOOKAHEAD` samples to come.
"""

import numpy as np
from scipy.signal import firwin, upfirdn

from torchpi.operators.play_kernel import play_bank_forward

FACTOR = 4
HALF_LENGTH = 40
"""Of the filter, in samples of the input: at 0.94 of the Nyquist frequency it still passes."""
LOOKAHEAD = 2 * HALF_LENGTH


def play_excess(u: np.ndarray, thresholds: np.ndarray) -> np.ndarray:
    """P_r[u] - u, low-passed, from plays at rest.

    Args:
        u: (time, inputs).
        thresholds: r, (plays,), in the unit of u.

    Returns:
        (time, inputs, plays).
    """
    if len(thresholds) == 0:
        return np.zeros((*u.shape, 0))
    taps = firwin(2 * FACTOR * HALF_LENGTH + 1, 1.0 / FACTOR, window=("kaiser", 6.0))
    late = FACTOR * HALF_LENGTH
    fine = upfirdn(FACTOR * taps, u, up=FACTOR, axis=0)[late : late + FACTOR * len(u)]
    x = np.ascontiguousarray(fine.T)  # (inputs, fine time)
    h = np.empty((*x.shape, len(thresholds)))
    play_bank_forward(x, thresholds, np.zeros((len(x), len(thresholds))), h)
    h -= x[..., None]
    padded = np.concatenate([h, np.zeros((len(x), late, len(thresholds)))], axis=1)
    low = upfirdn(taps, padded, down=FACTOR, axis=1)[:, HALF_LENGTH : HALF_LENGTH + len(u)]
    return np.ascontiguousarray(low.swapaxes(0, 1))
