"""What an amplifier and an actuator add to a band-limited voltage, taken between its samples.

Sampled at little more than twice its highest frequency, a signal turns between samples: plays of the
samples alone miss how far it went. So the input is interpolated, what it causes is taken at the higher rate,
and low-passed back to the rate of the samples. Both filters are of linear phase: the result knows
`LOOKAHEAD` samples to come.
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy.signal import bilinear, firwin, lfilter, upfirdn

from torchpi.operators.relaxing_play import relaxing_plays

FACTOR = 4
HALF_LENGTH = 40
"""Of the filter, in samples of the input: at 0.94 of the Nyquist frequency it still passes."""
LOOKAHEAD = 2 * HALF_LENGTH
TAPS = firwin(2 * FACTOR * HALF_LENGTH + 1, 1.0 / FACTOR, window=("kaiser", 6.0))


class OversampledInputs:
    """What plays and amplifiers add to voltages, window after window.

    Relaxing plays add h - u. The current into a piezo actuator follows the slope of its voltage v. An output
    stage of class B loses some of its voltage where the current changes sign, and the amplifier's loop takes
    back what of that lies below its bandwidth ω (Self, Audio Power Amplifier Design, 2013, ch. 9):

        v̇ = ω (u - v),   e = s/(s + ω) tanh(v̇/w)

    Where the signs change at another current than zero, there is some of tanh² as well.

    Args:
        inputs: How many voltages.
        rate_hz: Sample rate, Hz.
        thresholds: r of the plays, V.
        rates_hz: ω / 2π of the plays, Hz.
        widths: w, V/s.
        corner_hz: ω / 2π of the amplifiers, Hz.
    """

    def __init__(
        self,
        inputs: int,
        rate_hz: float,
        thresholds: Sequence[float] = (),
        rates_hz: Sequence[float] = (),
        widths: Sequence[float] = (),
        corner_hz: float = math.inf,
    ) -> None:
        fine_hz = FACTOR * rate_hz
        self.thresholds, self.widths = np.asarray(thresholds, float), np.asarray(widths, float)
        self.kept = np.exp(-2 * np.pi * np.asarray(rates_hz, float) / fine_hz)
        self.omega = 2 * np.pi * corner_hz
        self.high_pass = bilinear([1.0, 0.0], [1.0, self.omega], fine_hz) if len(widths) else None
        self.u = np.zeros((2 * HALF_LENGTH, inputs))
        self.h = np.zeros((inputs, len(thresholds)))
        self.slope, self.lost = np.zeros((1, inputs)), np.zeros((1, inputs, 2 * len(widths)))
        self.fine = np.zeros((2 * FACTOR * HALF_LENGTH, inputs, len(thresholds) + 2 * len(widths)))

    def advance(self, u: np.ndarray) -> np.ndarray:
        """(time, inputs, plays, then tanh of each width, then tanh²), of `LOOKAHEAD` samples before u's."""
        known = np.concatenate([self.u, u])
        late = 2 * FACTOR * HALF_LENGTH
        x = upfirdn(FACTOR * TAPS, known, up=FACTOR, axis=0)[late : late + FACTOR * len(u)]
        fine = np.concatenate([self.fine, np.concatenate([self._plays(x), self._crossover(x)], 2)])
        low = upfirdn(TAPS, fine, down=FACTOR, axis=0)[2 * HALF_LENGTH : 2 * HALF_LENGTH + len(u)]
        self.u, self.fine = known[len(u) :], fine[FACTOR * len(u) :]
        return np.ascontiguousarray(low)

    def _plays(self, x: np.ndarray) -> np.ndarray:
        each = np.ascontiguousarray(x.T)  # (inputs, fine time)
        h = np.empty((*each.shape, len(self.thresholds)))
        relaxing_plays(each, self.thresholds, self.kept, self.h, h)
        h -= each[..., None]
        return h.swapaxes(0, 1)

    def _crossover(self, x: np.ndarray) -> np.ndarray:
        if self.high_pass is None:
            return np.zeros((*x.shape, 0))
        slope, self.slope = lfilter(*self.high_pass, x, axis=0, zi=self.slope)
        odd = np.tanh(self.omega * slope[..., None] / self.widths)
        lost, self.lost = lfilter(*self.high_pass, np.concatenate([odd, odd**2], 2), axis=0, zi=self.lost)
        return np.asarray(lost)
