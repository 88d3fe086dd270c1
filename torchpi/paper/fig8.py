"""Fig. 8, Qin et al. (2013): the indirect approach through the plant of Fig. 7, on the sines of eq. 9."""

from dataclasses import dataclass

import numpy as np
import torch

from torchpi.indirect.rate_dependent import RateDependentInverse
from torchpi.motion import Motion
from torchpi.paper.fig7_plant import OFFSETS, SAMPLE_PERIOD_S, SLOPES, THRESHOLDS, Fig7Plant

FREQUENCIES_HZ = (5, 10, 50, 100)
PEAK_TO_PEAK_UM = 9.0


@dataclass(frozen=True)
class Fig8:
    """One panel: the last cycle, which is the steady state, and the start apart."""

    frequency_hz: float
    yd: np.ndarray  # (cycle,), µm
    y: np.ndarray  # (cycle,), µm
    max_percent: float  # of 9 µm
    rms_percent: float
    start_max_percent: float  # of all cycles before


def indirect(
    frequency_hz: float,
    cycles: int = 5,
    sample_period_s: float = SAMPLE_PERIOD_S,
) -> Fig8:
    """The conventional inversion with k ẏ_d + b put in, then the plant with k u̇ + b.

    ẏ_d is exact, from eq. 9; u̇ is the plant's own difference of the voltages that it is given.
    """
    samples = round(1 / (frequency_hz * sample_period_s))
    omega = 2 * torch.pi * frequency_hz
    phase = omega * sample_period_s * torch.arange(cycles * samples + 1, dtype=torch.float64)[None]
    motion = Motion(
        5.5 - 4.5 * torch.cos(phase), 4.5 * omega * torch.sin(phase), 4.5 * omega**2 * torch.cos(phase)
    )
    inverse = fig8_inverse(sample_period_s)
    y, _ = Fig7Plant(sample_period_s).simulate(inverse(motion))
    percent = 100 * (y - motion.yd)[0].numpy() / PEAK_TO_PEAK_UM
    last = slice(len(percent) - samples - 1, None)
    return Fig8(
        frequency_hz=frequency_hz,
        yd=motion.yd[0, last].numpy(),
        y=y[0, last].numpy(),
        max_percent=float(np.abs(percent[last]).max()),
        rms_percent=float(np.sqrt(np.mean(percent[last] ** 2))),
        start_max_percent=float(np.abs(percent[: last.start]).max(initial=0.0)),
    )


def fig8_inverse(sample_period_s: float = SAMPLE_PERIOD_S) -> RateDependentInverse:
    """The paper's indirect compensator for the plant, with the plant's own numbers and without limits."""
    return RateDependentInverse(
        sample_period_s,
        THRESHOLDS,
        SLOPES,
        OFFSETS,
        min_voltage_v=-float("inf"),
        max_voltage_v=float("inf"),
    )
