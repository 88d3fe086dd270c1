"""Displacements that a compensator reaches within its output limits."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchpi.errors import RecordingError

POINTS = 4000
BEYOND = 0.05
"""Share of the reach allowed beyond it: creep and noise take replayed long records a few percent on."""

Law = Callable[[Tensor], Tensor]  # desired displacement (time,), µm, from the de-energised state, to V


class Reach(NamedTuple):
    """Displacements at which the voltage of a slow motion meets the output limits, µm.

    Attributes:
        low_um: The lowest, coming from the de-energised state.
        high_um: The highest, coming from the de-energised state.
        remanence_um: Where the lower limit is met on the way down from the highest: the stage comes no
            lower until it is de-energised again.
    """

    low_um: float
    high_um: float
    remanence_um: float


def reach(law: Law, min_voltage_v: float, max_voltage_v: float) -> Reach:
    """Follow the loop of a slow motion to its ends: up and down from the de-energised state, and back.

    If a limit is not met within 10 mm, or is not finite, that end is set to 10 mm.
    """
    steps = torch.cat(
        [torch.zeros(1, dtype=torch.float64), torch.logspace(-3, 4, POINTS, dtype=torch.float64)]
    )
    high = _end(steps, law(steps), min_voltage_v, max_voltage_v)
    # Downwards it is the same problem with both signs reversed.
    low = 0.0 - _end(steps, -law(-steps), -max_voltage_v, -min_voltage_v)
    up = torch.linspace(0.0, high, POINTS, dtype=torch.float64)
    back = torch.linspace(high, min(low, -high), 2 * POINTS, dtype=torch.float64)
    down = law(torch.cat([up, back]))[POINTS:] <= min_voltage_v
    remanence = float(back[int(down.int().argmax())]) if bool(down.any()) else low
    return Reach(low, high, remanence)


def check_reached(
    name: str,
    yd: npt.NDArray[np.float64],  # (time,), µm
    ends_um: tuple[float, float],
    of: str,
) -> None:
    """Check that a desired displacement stays within what is reached, with the tolerance `BEYOND`.

    Args:
        name: Its name in the error message.
        yd: The desired displacement.
        ends_um: The lowest and the highest displacement that are reached.
        of: What reaches them, `stage` or `compensator`.

    Raises:
        RecordingError: It does not; the message names the sample that is furthest beyond.
    """
    low, high = ends_um
    tolerance = BEYOND * (high - low)
    k = int(np.argmax(np.maximum(low - yd, yd - high)))
    if not low - tolerance <= yd[k] <= high + tolerance:
        raise RecordingError(
            f"{name}: sample {k} is {yd[k]:.4g} µm, outside the range of this {of}, "
            f"{low:.3g} to {high:.3g} µm: scale the trajectory, or use another {of}"
        )


def _end(y: Tensor, u: Tensor, limit_behind_v: float, limit_ahead_v: float) -> float:
    """Return where the voltage first meets the limit ahead or runs away backwards, else the last place."""
    # The start may lie below the limits, which then begin further out.
    away = min(limit_behind_v, float(u[0])) - (limit_ahead_v - limit_behind_v)
    met = (u >= limit_ahead_v) | (u <= away) | ~torch.isfinite(u)
    k = int(met.int().argmax()) if bool(met.any()) else len(u) - 1
    if k == 0:
        return 0.0
    rise = float(u[k] - u[k - 1])
    share = float(limit_ahead_v - u[k - 1]) / rise if rise > 0 else 0.0
    return float(y[k - 1]) + min(max(share, 0.0), 1.0) * float(y[k] - y[k - 1])
