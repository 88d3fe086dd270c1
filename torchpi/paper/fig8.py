"""Fig. 8, Qin et al. (2013): the plant of Fig. 7 driven by an inverse, for the sines of eq. 9.

The paper uses the indirect approach. Here the direct one is run beside it, on the same plant.
"""

from dataclasses import dataclass

import numpy as np
import torch

from torchpi.control.indirect.rate_dependent import RateDependentInverse
from torchpi.operators.motion import Motion
from torchpi.paper.fig7_plant import OFFSETS, SAMPLE_PERIOD_S, SLOPES, THRESHOLDS, Fig7Plant
from torchpi.paper.tracking import Deployed, follow

FREQUENCIES_HZ = (5, 10, 50, 100)
PEAK_TO_PEAK_UM = 9.0


@dataclass(frozen=True)
class Fig8:
    """One panel: the last cycle, which is the steady state, and the error before it."""

    frequency_hz: float
    yd: np.ndarray  # (cycle,), µm
    y: np.ndarray  # (cycle,), µm
    max_percent: float  # of 9 µm
    rms_percent: float
    start_max_percent: float  # of all earlier cycles


def indirect(
    frequency_hz: float,
    cycles: int = 5,
    sample_period_s: float = SAMPLE_PERIOD_S,
) -> Fig8:
    """Run the conventional inversion with weights k ẏ_d + b, then the plant with weights k u̇ + b.

    ẏ_d is exact, from eq. 9; u̇ is the difference that the plant forms from its input voltages.
    """
    samples = round(1 / (frequency_hz * sample_period_s))
    motion = _eq_9(frequency_hz, sample_period_s, cycles * samples + 1)
    y, _ = Fig7Plant(sample_period_s).simulate(fig8_inverse(sample_period_s)(motion))
    return _judged(frequency_hz, motion.yd[0].numpy(), y[0].numpy(), samples)


def fig8_inverse(sample_period_s: float = SAMPLE_PERIOD_S) -> RateDependentInverse:
    """Return the paper's indirect compensator with the plant's own parameters and without limits."""
    return RateDependentInverse(
        sample_period_s,
        THRESHOLDS,
        OFFSETS,
        weight_slopes=SLOPES,
        min_voltage_v=-float("inf"),
        max_voltage_v=float("inf"),
    )


def deployed(compensator: Deployed, frequency_hz: float, cycles: int = 5) -> Fig8:
    """Run any compensator as exported, y_d sample by sample, then the plant."""
    period_s = compensator.sample_period_s
    samples = round(1 / (frequency_hz * period_s))
    length = cycles * samples + 1
    yd = _eq_9(frequency_hz, period_s, length + compensator.preview).yd[0].numpy()
    followed = follow(compensator, Fig7Plant(period_s), yd[:length], yd[length:])
    return _judged(frequency_hz, yd[:length], followed.y, samples)


def _eq_9(frequency_hz: float, sample_period_s: float, samples: int) -> Motion:
    """Return y_d = 5.5 + 4.5 sin(2πft − π/2), µm, with its derivatives."""
    omega = 2 * torch.pi * frequency_hz
    phase = omega * sample_period_s * torch.arange(samples, dtype=torch.float64)[None]
    return Motion(
        5.5 - 4.5 * torch.cos(phase), 4.5 * omega * torch.sin(phase), 4.5 * omega**2 * torch.cos(phase)
    )


def _judged(frequency_hz: float, yd: np.ndarray, y: np.ndarray, cycle: int) -> Fig8:
    percent = 100 * (y - yd) / PEAK_TO_PEAK_UM
    last = slice(len(percent) - cycle - 1, None)
    return Fig8(
        frequency_hz=frequency_hz,
        yd=yd[last],
        y=y[last],
        max_percent=float(np.abs(percent[last]).max()),
        rms_percent=float(np.sqrt(np.mean(percent[last] ** 2))),
        start_max_percent=float(np.abs(percent[: last.start]).max(initial=0.0)),
    )
