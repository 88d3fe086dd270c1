"""A small oscillator with hysteresis, its excitation, and an independent integration of its equations."""

import numpy as np
from scipy.integrate import solve_ivp

from torchpi.operators.bouc_wen_oscillator import BoucWenParameters
from torchpi.stage.bouc_wen_oscillator import BoucWenOscillator

RATE_HZ = 500.0
PARAMETERS = BoucWenParameters(0.8, 3.0, 1.2e4, 8e3, 900.0, -600.0, 1.0)


def an_oscillator(
    rate_hz: float = RATE_HZ, between: str = "band_limited", **changes: float
) -> BoucWenOscillator:
    return BoucWenOscillator(rate_hz, {**PARAMETERS._asdict(), **changes}, between)


def multisine(samples: int, rms: float = 10.0, seed: int = 0, factor: int = 1) -> np.ndarray:
    """Return one period of a multisine from 4 Hz to 100 Hz, at `factor` times the rate."""
    random, length_s = np.random.default_rng(seed), samples / RATE_HZ
    spectrum = np.zeros(samples * factor // 2 + 1, complex)
    lines = np.arange(round(4 * length_s), round(100 * length_s))
    spectrum[lines] = np.exp(2j * np.pi * random.random(len(lines)))
    u = np.fft.irfft(spectrum)
    return rms * u / u.std()


def integrated(p: BoucWenParameters, force, t: np.ndarray) -> np.ndarray:
    """Return the displacement, µm, at times t under force(t), integrated adaptively with order 8."""

    def slopes(time: float, state: np.ndarray) -> list[float]:
        x, v, z = state
        hysteresis = (
            p.dissipation * abs(v) * abs(z) ** (p.exponent - 1) * z + p.hardening * v * abs(z) ** p.exponent
        )
        a = (force(time) - p.damping_n_s_m * v - p.stiffness_n_m * x - z) / p.mass_kg
        return [v, a, p.hysteretic_stiffness_n_m * v - hysteresis]

    # Steps are kept to a small part of a sample, as the slopes have kinks where the motion reverses.
    longest = (t[1] - t[0]) / 4
    found = solve_ivp(slopes, t[[0, -1]], np.zeros(3), "DOP853", t, rtol=1e-9, atol=1e-12, max_step=longest)
    return 1e6 * found.y[0]
