"""Spectral lines in a stretch of noise: hum and other tones, which are not noise."""

import numpy as np
from scipy.ndimage import median_filter

STANDS_OUT = 35.0
"""Multiple of the median around it that makes a line: exponential noise gets there once in 10¹⁰ bins."""
AROUND = 101
"""Number of frequency bins that are the surroundings of one."""
BESIDE = (3, 9)
"""Distances in frequency bins from a line to where it ends, and to where its nearest surroundings end."""
AT_MOST = 10
"""Maximum number of lines."""
RESOLVED = 0.25
"""Frequency resolution, in units of 1 / (length of the record): lines closer than this are one line."""
OVERTONES = 20
"""Number of harmonics of a line that are looked for, up to the kilohertz of a rectified mains voltage."""


def without_lines(e: np.ndarray) -> np.ndarray:
    """Subtract from a stretch of noise, (time,), the lines that stand out of the spectrum beyond chance."""
    for _ in range(AT_MOST):
        power = periodogram(e)
        around = median_filter(power, AROUND, mode="reflect") + np.finfo(float).tiny
        place = int(np.argmax(power[4:] / around[4:])) + 4 if len(power) > AROUND else 0
        if place == 0 or power[place] < STANDS_OUT * around[place]:
            break
        size = 1 << (4 * len(e)).bit_length()
        fine, f = periodogram(e, size), np.arange(size // 2 + 1) / size
        near = np.abs(f - place / len(e)) < 1.5 / len(e)
        wave = np.exp(2j * np.pi * f[near][fine[near].argmax()] * np.arange(len(e)))
        columns = np.stack([wave.real, wave.imag])
        e = e - np.linalg.lstsq(columns.T, e, rcond=None)[0] @ columns
    return e


def above_surroundings(x: np.ndarray, cycles: float) -> float:
    """Return the power of a signal, (time,), at `cycles` cycles in its length, relative to its surroundings.

    The nearest frequencies are also compared separately: a ringing mode is as loud there, a line is not.
    """
    power, place = periodogram(x - x.mean()), round(cycles)
    if not BESIDE[1] <= place < len(power) - BESIDE[1]:
        return 0.0
    near = np.concatenate([power[place + way * np.arange(*BESIDE)] for way in (-1, 1)])
    around = power[max(place - AROUND // 2, 0) : place + AROUND // 2 + 1]
    least = np.finfo(float).tiny + np.finfo(float).eps * power.max()
    return float(power[place - 1 : place + 2].max() / max(near.mean(), np.median(around), least))


def periodogram(x: np.ndarray, padded: int | None = None) -> np.ndarray:
    """Return |X(f)|² with a Hann window, of the signal as it is or padded with zeros to `padded` samples."""
    power: np.ndarray = np.abs(np.fft.rfft(x * np.hanning(len(x)), padded)) ** 2
    return power


def is_overtone(line_hz: float, of_hz: float, fs_hz: float, length_s: float) -> bool:
    """Whether a line is a harmonic of another, or what sampling makes of one above half the sample rate."""
    harmonics = of_hz * np.arange(2, OVERTONES + 1)
    sampled_hz = np.abs(harmonics - fs_hz * np.round(harmonics / fs_hz))
    return bool((np.abs(sampled_hz - line_hz) * length_s < RESOLVED).any())
