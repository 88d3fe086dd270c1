"""Lines of the mains in what is left."""

from collections.abc import Sequence

import numpy as np

from torchpi.diagnosis.evidence import spectrum
from torchpi.diagnosis.hypothesis import Fit
from torchpi.diagnosis.records import Record
from torchpi.stage.effects.sensor.hum import MAINS_HZ

STANDS_OUT = 35.0
"""Times the median of its surroundings: exponential noise gets there once in 10¹⁰ frequencies."""


def lines_hz(now: Fit, records: Sequence[Record]) -> list[float]:
    """For each line of the mains the strongest one of the residual within 1 % of it."""
    best = [(-1.0, mains) for mains in MAINS_HZ]
    for record, e in zip(records, now.residuals, strict=True):
        size = 1 << (4 * len(e)).bit_length()
        f, power = np.fft.rfftfreq(size, record.period_s), spectrum(e, size) / len(e)
        for i, mains in enumerate(MAINS_HZ):
            inside = (f > 0.99 * mains) & (f < 1.01 * mains)
            if inside.any() and power[inside].max() > best[i][0]:
                best[i] = (float(power[inside].max()), float(f[inside][power[inside].argmax()]))
    return [line for _, line in best]


def hums(now: Fit, records: Sequence[Record]) -> bool:
    """Whether a line of the mains stands out of the residual's spectrum beyond chance."""
    for record, e in zip(records, now.residuals, strict=True):
        f = np.fft.rfftfreq(len(e), record.period_s)
        power = spectrum(e)
        for mains in MAINS_HZ:
            around, near = np.abs(f - mains) < 0.2 * mains, np.abs(f - mains) < 0.02 * mains
            if near.any() and power[near].max() > STANDS_OUT * np.median(power[around]):
                return True
    return False
