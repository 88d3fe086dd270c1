"""Fig. 13, Qin et al. (2013), as numbers: width and nonlinearity of the loop of y over y_d, by frequency."""

from dataclasses import dataclass

import numpy as np
import torch

from torchpi.operators.reference_filter import ReferenceFilter
from torchpi.paper.tracking import Deployed, Plant, follow

FREQUENCIES_HZ = (1, 2, 5, 10, 20, 40, 60, 80)
LOW_UM, HIGH_UM = 1.0, 7.0  # as eq. 15
SETTLED_S = 0.1  # settling time of the reference filter before the evaluated cycles
LEVELS = 401


@dataclass(frozen=True)
class Loop:
    """The steady loop of one sine."""

    frequency_hz: float
    yd: np.ndarray  # (time,), µm, one cycle or a few
    y: np.ndarray  # (time,), µm
    width_percent: float  # largest distance of its two branches, % of the range
    nonlinearity_percent: float  # largest deviation of its mean branch from a line, % of the range
    max_percent: float  # largest |y − y_d|, % of the range


def loop(compensator: Deployed, plant: Plant, frequency_hz: float) -> Loop:
    """Track a sine over 1 … 7 µm, passed through the reference filter, and evaluate its steady state."""
    rate_hz = plant.sample_rate_hz
    cycle = rate_hz / frequency_hz
    counted = _whole_cycles(cycle)
    # At least one cycle passes the maximum before the evaluated cycles.
    before = int(np.ceil(max(1, SETTLED_S * frequency_hz)) * cycle)
    samples = before + counted + 1
    phase = 2 * np.pi * frequency_hz * np.arange(samples + compensator.preview) / rate_hz
    middle, half = (HIGH_UM + LOW_UM) / 2, (HIGH_UM - LOW_UM) / 2
    reference = torch.from_numpy(middle - half * np.cos(phase))[None]
    yd = ReferenceFilter(1 / rate_hz)(reference).yd[0].numpy()
    run = follow(compensator, plant, yd[:samples], yd[samples:])
    steady = slice(before, samples)
    width, bend = width_and_bend(yd[steady], run.y[steady])
    return Loop(
        float(frequency_hz),
        yd[steady],
        run.y[steady],
        100 * width / (HIGH_UM - LOW_UM),
        100 * bend / (HIGH_UM - LOW_UM),
        100 * float(np.abs(run.y[steady] - yd[steady]).max()) / (HIGH_UM - LOW_UM),
    )


def width_and_bend(
    yd: np.ndarray,  # (time,), up and down at least once
    y: np.ndarray,  # (time,)
) -> tuple[float, float]:
    """Return the largest distance of rising and falling branch, and of their mean from a straight line."""
    rising = np.gradient(yd) > 0
    levels = np.linspace(yd.min(), yd.max(), LEVELS)[4:-4]
    up, down = (_branch(yd[part], y[part], levels) for part in (rising, ~rising))
    middle = (up + down) / 2
    straight = np.polyval(np.polyfit(levels, middle, 1), levels)
    return float(np.abs(up - down).max()), float(np.abs(middle - straight).max())


def _branch(yd: np.ndarray, y: np.ndarray, levels: np.ndarray) -> np.ndarray:
    order = np.argsort(yd)
    return np.asarray(np.interp(levels, yd[order], y[order]))


def _whole_cycles(cycle: float) -> int:
    """Return the length in samples of the fewest cycles, at most ten, that span a whole number of samples."""
    for cycles in range(1, 11):
        if abs(cycles * cycle - round(cycles * cycle)) < 1e-6:
            return round(cycles * cycle)
    return round(10 * cycle)
