"""Fig. 4, Qin et al. (2013): a cubic compared with six one-sided dead zones, 3 coefficients with 11.

The paper gives no coefficients. Here the cubic resembles eq. 12 as a stage needs it. Six zones approximate it
over 0 … 8.1 µm; their five thresholds are evenly spaced, and their weights are fitted.
"""

from dataclasses import dataclass

import numpy as np
import torch

from torchpi.operators.dead_zone import fit_dead_zones
from torchpi.operators.polynomial import Polynomial

CUBIC = [1.40, -7.62e-2, 6.0e-3]  # c_1, c_2, c_3
RANGE_UM = 8.1
ZONES = 6


@dataclass(frozen=True)
class Fig4:
    """Both curves over the range, and the distance between them."""

    x: np.ndarray  # (points,), µm
    cubic: np.ndarray  # (points,)
    dead_zones: np.ndarray  # (points,)
    cubic_numbers: int
    dead_zone_numbers: int  # weights, and the thresholds other than 0
    max_percent: float  # of the range of the cubic
    slope_jump_percent: float  # largest jump of the slope at a threshold, of the mean slope


def fig4(points: int = 811) -> Fig4:
    """Fit the dead zones to the cubic."""
    x = torch.linspace(0, RANGE_UM, points, dtype=torch.float64)
    with torch.no_grad():
        cubic = Polynomial(CUBIC)(x[None])[0][0]
        thresholds = [RANGE_UM * i / ZONES for i in range(ZONES)]
        zones = fit_dead_zones(x, cubic, thresholds)
        followed = zones(x[None])[0][0]
    height = float(cubic.max() - cubic.min())
    return Fig4(
        x=x.numpy(),
        cubic=cubic.numpy(),
        dead_zones=followed.numpy(),
        cubic_numbers=len(CUBIC),
        dead_zone_numbers=2 * ZONES - 1,
        max_percent=100 * float((followed - cubic).abs().max()) / height,
        slope_jump_percent=100 * float(zones.slopes.diff().abs().max()) / (height / RANGE_UM),
    )
