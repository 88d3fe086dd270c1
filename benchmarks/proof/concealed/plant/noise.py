"""Sensor noise of a given rms: white, autoregressive, or 1/f on white."""

import numpy as np
from concealed.plant.physics import Array
from scipy.signal import lfilter


def draw_noise(rng: np.random.Generator, colour: str, samples: int, rms_um: float) -> Array:
    """Noise of unit variance over a long time, times `rms_um`.

    "ar" is first order with its pole at 0.7 (a third of the power white); "flicker" is 1/f over all octaves
    of the recording (a fifth of the power).
    """
    white = rng.standard_normal(samples)
    if colour == "white":
        return rms_um * white
    if colour == "ar":
        pole = 0.7
        slow = lfilter([np.sqrt(1 - pole**2)], [1, -pole], rng.standard_normal(samples))
        return rms_um * (np.sqrt(1 / 3) * white + np.sqrt(2 / 3) * slow)
    spectrum = np.fft.rfft(rng.standard_normal(samples))
    spectrum[1:] /= np.sqrt(np.arange(1, spectrum.size))
    spectrum[0] = 0
    flicker = np.fft.irfft(spectrum, samples)
    return rms_um * (np.sqrt(0.8) * white + np.sqrt(0.2) * flicker / flicker.std())
