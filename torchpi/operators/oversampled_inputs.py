"""What an amplifier and an actuator add to a band-limited voltage, taken between its samples.

Sampled at little more than twice its highest frequency, a signal turns between samples: plays of the
samples alone miss how far it went. So the input is interpolated, what it causes is taken at the higher rate,
and low-passed back to the rate of the samples. Both filters are of linear phase: the result knows
`LOOKAHEAD` samples to come.
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy.signal import bilinear, firwin

from torchpi.operators.compiled import njit
from torchpi.operators.filters import decimate, interpolate
from torchpi.operators.relaxing_play import relaxing_play

FACTOR = 4
HALF_LENGTH = 40
"""Of the filter, in samples of the input: at 0.94 of the Nyquist frequency it still passes."""
LOOKAHEAD = 2 * HALF_LENGTH
TAPS = firwin(2 * FACTOR * HALF_LENGTH + 1, 1.0 / FACTOR, window=("kaiser", 6.0))
_play = njit(relaxing_play)


class OversampledInputs:
    """What plays and amplifiers add to voltages, window after window.

    Relaxing plays add h - u. The current into a piezo actuator follows the slope of its voltage v. An output
    stage of class B loses some of its voltage where the current changes sign, and the amplifier's loop takes
    back what of that lies below its bandwidth ω (Self, Audio Power Amplifier Design, 2013, ch. 9):

        v̇ = ω (u - v),   e = s/(s + ω) σ(v̇/w),   σ(s) = s/√(1 + s²)

    Where the signs change at another current than zero, there is some of σ² as well.

    Args:
        inputs: How many voltages.
        rate_hz: Sample rate, Hz.
        thresholds: r of the plays, V.
        rates_hz: ω / 2π of the plays, Hz.
        widths: w, V/s.
        corner_hz: ω / 2π of the amplifiers, Hz.
        weights: (inputs, all of them), V, in which they are added up; without any each is kept.
    """

    def __init__(
        self,
        inputs: int,
        rate_hz: float,
        thresholds: Sequence[float] = (),
        rates_hz: Sequence[float] = (),
        widths: Sequence[float] = (),
        corner_hz: float = math.inf,
        weights: np.ndarray | None = None,
    ) -> None:
        fine_hz = FACTOR * rate_hz
        self.thresholds, self.widths = np.asarray(thresholds, float), np.asarray(widths, float)
        self.kept = np.exp(-2 * np.pi * np.asarray(rates_hz, float) / fine_hz)
        self.omega, self.high_pass = 0.0, np.zeros(3)
        if len(widths):
            self.omega = 2 * math.pi * corner_hz
            (b0, b1), (_, a1) = bilinear([1.0, 0.0], [1.0, self.omega], fine_hz)
            self.high_pass = np.array([b0, b1, a1])
        self.weights = weights
        self.columns = len(thresholds) + 2 * len(widths)
        self.u = np.zeros((2 * HALF_LENGTH, inputs))
        self.h = np.zeros((inputs, len(thresholds)))
        self.slope, self.lost = np.zeros(inputs), np.zeros((inputs, 2 * len(widths)))
        kept = self.columns if weights is None else 1
        self.fine = np.zeros((2 * FACTOR * HALF_LENGTH, inputs * kept))

    def advance(self, u: np.ndarray) -> np.ndarray:
        """(time, inputs, plays, then σ of each width, then σ²), of `LOOKAHEAD` samples before u's.

        With weights their sum, (time, inputs, 1).
        """
        known, inputs = np.concatenate([self.u, u]), u.shape[1]
        x, low = np.empty((FACTOR * len(u), inputs)), np.empty((len(u), self.fine.shape[1]))
        interpolate(known, FACTOR * TAPS, FACTOR, x)
        added = np.empty((len(x), inputs, self.columns))
        at_higher_rate(
            x, self.thresholds, self.kept, self.widths, self.omega, self.high_pass, self.h, self.slope,
            self.lost, added,
        )  # fmt: skip
        if self.weights is not None:
            total = np.empty((len(x), inputs, 1))
            weighted_sum(added, self.weights, total)
            added = total
        fine = np.concatenate([self.fine, added.reshape(len(x), -1)])
        decimate(fine, TAPS, FACTOR, low)
        self.u, self.fine = known[len(u) :], fine[len(x) :]
        return low.reshape(len(u), inputs, -1)


@njit
def at_higher_rate(
    x: np.ndarray,  # (time, inputs), V
    thresholds: np.ndarray,  # (plays,)
    kept: np.ndarray,  # (plays,), what a sample leaves of small motions
    widths: np.ndarray,  # (widths,), V/s
    omega: float,  # of the amplifiers, 1/s
    high_pass: np.ndarray,  # (3,), s/(s + ω): b_0, b_1 and a_1 of its difference equation
    h: np.ndarray,  # (inputs, plays), state; left as after the last sample, like those below
    slope: np.ndarray,  # (inputs,), of the filter that gives the current
    lost: np.ndarray,  # (inputs, 2 widths), of those behind the crossover
    added: np.ndarray,  # (time, inputs, plays + 2 widths), written
) -> None:
    """What `OversampledInputs` adds, sample by sample at the higher rate."""
    plays, many = len(thresholds), len(widths)
    b0, b1, a1 = high_pass
    for t in range(x.shape[0]):
        for i in range(x.shape[1]):
            u = x[t, i]
            for r in range(plays):
                h[i, r] = _play(u, thresholds[r], kept[r], h[i, r])
                added[t, i, r] = h[i, r] - u
            if many == 0:
                continue
            fast = b0 * u + slope[i]  # u - v
            slope[i] = b1 * u - a1 * fast
            for q in range(many):
                s = omega * fast / widths[q]
                odd = s / np.sqrt(1.0 + s * s)
                for part, crossed in ((q, odd), (many + q, odd * odd)):
                    e = b0 * crossed + lost[i, part]
                    lost[i, part] = b1 * crossed - a1 * e
                    added[t, i, plays + part] = e


@njit
def weighted_sum(added: np.ndarray, weights: np.ndarray, total: np.ndarray) -> None:
    """Σ_r g_ir e_ir, (time, inputs, 1), from the first to the last."""
    for t in range(added.shape[0]):
        for i in range(added.shape[1]):
            sum_ = 0.0
            for r in range(added.shape[2]):
                sum_ += weights[i, r] * added[t, i, r]
            total[t, i, 0] = sum_
