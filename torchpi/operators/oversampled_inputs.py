"""Contributions of an amplifier and an actuator to a band-limited voltage, computed between its samples.

A signal sampled at little more than twice its highest frequency reverses between samples, and plays of the
samples alone miss its extremes. The input is therefore interpolated, the contributions are computed at the
higher rate, and a low-pass brings them back to the sample rate. Both filters are of linear phase, so that
the result depends on `LOOKAHEAD` future samples.
"""

import math
from collections.abc import Sequence
from functools import cache

import numpy as np

from torchpi.operators.compiled import njit
from torchpi.operators.filters import decimate, interpolate
from torchpi.operators.relaxing_play import relaxing_play

FACTOR = 4
HALF_LENGTH = 40
"""Half length of the filter, in samples of the input: it still passes 0.94 of the Nyquist frequency."""
LOOKAHEAD = 2 * HALF_LENGTH
_play = njit(relaxing_play)


@cache
def low_pass_taps() -> np.ndarray:
    """Return the coefficients of the low-pass, (taps,)."""
    # Imported here, because the import takes half a second and few stages have these inputs.
    from scipy.signal import firwin

    taps: np.ndarray = firwin(2 * FACTOR * HALF_LENGTH + 1, 1.0 / FACTOR, window=("kaiser", 6.0))
    return taps


def taps_by_phase() -> tuple[np.ndarray, np.ndarray]:
    """Return the coefficients as the exports use them, block of `FACTOR` samples by block.

    The first are those of the interpolation, padded with zeros to whole blocks, (taps,). The others are those
    with which each sample of a block contributes to the later outputs, (`FACTOR`, blocks).
    """
    taps = low_pass_taps()
    blocks = len(taps) // FACTOR
    interpolation = np.zeros(FACTOR * (blocks + 1))
    interpolation[: len(taps)] = FACTOR * taps
    return interpolation, np.stack([taps[FACTOR - q :: FACTOR][:blocks] for q in range(FACTOR)])


class OversampledInputs:
    """Contributions of plays and amplifiers to voltages, window after window.

    Relaxing plays add h - u. The current into a piezo actuator follows the slope of its voltage v. A class-B
    output stage loses some of its voltage where the current changes sign, and the amplifier's loop corrects
    the part of that loss below its bandwidth ω (Self, Audio Power Amplifier Design, 2013, ch. 9):

        v̇ = ω (u - v),   e = s/(s + ω) σ(v̇/w),   σ(s) = s/√(1 + s²)

    If the loss occurs at a current other than zero, there is a contribution of σ² as well.

    Args:
        inputs: Number of voltages.
        rate_hz: Sample rate, Hz.
        thresholds: r of the plays, V.
        rates_hz: ω / 2π of the plays, Hz.
        widths: w, V/s.
        corner_hz: ω / 2π of the amplifiers, Hz.
        weights: (inputs, contributions), V, of their sum; without weights each contribution is kept.
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
            from scipy.signal import bilinear  # here for the reason above

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
        """Return (time, inputs, plays, then σ of each width, then σ²), `LOOKAHEAD` samples behind u.

        With weights, return the weighted sum, (time, inputs, 1).
        """
        known, inputs = np.concatenate([self.u, u]), u.shape[1]
        x, low = np.empty((FACTOR * len(u), inputs)), np.empty((len(u), self.fine.shape[1]))
        interpolate(known, FACTOR * low_pass_taps(), FACTOR, x)
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
        decimate(fine, low_pass_taps(), FACTOR, low)
        self.u, self.fine = known[len(u) :], fine[len(x) :]
        return low.reshape(len(u), inputs, -1)


@njit
def at_higher_rate(
    x: np.ndarray,  # (time, inputs), V
    thresholds: np.ndarray,  # (plays,)
    kept: np.ndarray,  # (plays,), factor by which small deviations decay in a sample
    widths: np.ndarray,  # (widths,), V/s
    omega: float,  # bandwidth of the amplifiers, 1/s
    high_pass: np.ndarray,  # (3,), s/(s + ω): b_0, b_1 and a_1 of its difference equation
    h: np.ndarray,  # (inputs, plays), state; updated in place, like those below
    slope: np.ndarray,  # (inputs,), state of the filter that gives the current
    lost: np.ndarray,  # (inputs, 2 widths), state of the filters behind the crossover
    added: np.ndarray,  # (time, inputs, plays + 2 widths), written
) -> None:
    """Compute the contributions of `OversampledInputs`, sample by sample at the higher rate."""
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
    """Compute Σ_r g_ir e_ir, (time, inputs, 1), summed from the first to the last."""
    for t in range(added.shape[0]):
        for i in range(added.shape[1]):
            sum_ = 0.0
            for r in range(added.shape[2]):
                sum_ += weights[i, r] * added[t, i, r]
            total[t, i, 0] = sum_
