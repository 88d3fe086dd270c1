"""Fig. 5, Qin et al. (2013): effect of the polynomial of eq. 5 on the loop of an inverse model."""

import numpy as np
import torch

from torchpi.operators.polynomial import Polynomial
from torchpi.operators.prandtl_ishlinskii import PrandtlIshlinskii

POLYNOMIAL = [0.5, 0.0, 2e-3, 0.0, 1e-4]  # c_1 … c_5, eq. 5
THRESHOLDS = [0.5 * i for i in range(10)]
WEIGHTS = [5.0, -1.0, -1.0, -1.0, -0.5, -0.5, -0.2, -0.1, -0.05, -0.01]
AMPLITUDE = 10.0  # of the input; the paper gives none


def loop(
    amplitude: float = AMPLITUDE,
    with_polynomial: bool = True,
    samples: int = 4_000,  # of one period
) -> tuple[np.ndarray, np.ndarray]:  # input (samples + 1,), output
    """Return the closed loop of the inverse model, eq. 6: the second period of a sine over ±amplitude."""
    phase = 2 * torch.pi * torch.arange(2 * samples + 1, dtype=torch.float64)[None] / samples
    x = amplitude * torch.sin(phase)
    with torch.no_grad():
        s = Polynomial(POLYNOMIAL, amplitude)(x)[0] if with_polynomial else x
        u = PrandtlIshlinskii(THRESHOLDS, WEIGHTS)(s)[0]
    return x[0, samples:].numpy(), u[0, samples:].numpy()


def end_slope_ratio() -> float:
    """Return the slope of the rising branch at its upper end relative to its middle: near-vertical ends."""
    x, u = loop()
    samples = len(x) - 1
    up = np.r_[x[3 * samples // 4 :], x[1 : samples // 4 + 1]]
    height = np.r_[u[3 * samples // 4 :], u[1 : samples // 4 + 1]]
    slope = np.gradient(height, up)
    middle = np.abs(up) < 0.2 * AMPLITUDE
    end = up > 0.97 * AMPLITUDE
    return float(slope[end].mean() / slope[middle].mean())
