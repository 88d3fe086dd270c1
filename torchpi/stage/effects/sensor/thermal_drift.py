"""Drift in absolute time, of a stage that warms up: y = x + A (1 - e^{-t/τ}) + ρ t, t from the first sample.

ΔL = L₀ α ΔT, the temperature being that of one heat capacity behind one resistance (A, τ), or still far
from where it settles (ρ).
"""

import math
from typing import Any, ClassVar

import numba
import numpy as np
import torch
from torch import Tensor, nn

from torchpi.operators.quantity import Quantity
from torchpi.stage.effects.added_signal import AddedSignal
from torchpi.stage.effects.effect import Parameters, Seen

SLOWEST_DYNAMICS_S = 0.5
"""What settles faster is no drift of temperature."""


def drift(t_s: float, amplitude_um: float, time_constant_s: float, rate_um_per_s: float) -> float:
    """A (1 - e^{-t/τ}) + ρ t."""
    return amplitude_um * (1.0 - math.exp(-t_s / time_constant_s)) + rate_um_per_s * t_s


_drift: Any = numba.njit(drift)


@numba.njit(cache=True)
def _moved(
    elapsed: np.ndarray, period_s: float,
    amplitude_um: float, time_constant_s: float, rate_um_per_s: float, moved: np.ndarray,
) -> None:  # fmt: skip
    for batch in range(moved.shape[0]):
        for k in range(moved.shape[1]):
            t_s = (elapsed[batch] + k) * period_s
            moved[batch, k] = _drift(t_s, amplitude_um, time_constant_s, rate_um_per_s)


class ThermalDrift(AddedSignal):
    """A drift that settles, one that goes on, or both; how far it goes is another one in each recording."""

    name = "thermal_drift"
    block = "sensor"
    equation = "y = x + A (1 - e^{-t/τ}) + ρ t"
    signature = "slow, in absolute time: does not follow the last move"
    quantities: ClassVar[dict[str, Quantity]] = {
        "amplitude_um": Quantity("µm", at_least=-1e4, at_most=1e4),
        "time_constant_s": Quantity("s", at_least=SLOWEST_DYNAMICS_S, at_most=1e6),
        "rate_um_per_s": Quantity("µm/s", at_least=-1e3, at_most=1e3),
    }
    identity: ClassVar[Parameters] = {"amplitude_um": 0.0, "time_constant_s": 60.0, "rate_um_per_s": 0.0}
    per_recording = ("amplitude_um", "rate_um_per_s")
    signal, kernel = staticmethod(drift), staticmethod(_moved)
    amplitude_um: nn.Parameter
    time_constant_s: nn.Parameter
    rate_um_per_s: nn.Parameter

    @staticmethod
    def of_tensors(t_s: Tensor, a: Tensor, b: Tensor, c: Tensor) -> Tensor:
        return a * (1 - torch.exp(-t_s / b)) + c * t_s

    @classmethod
    def starts(cls, seen: Seen) -> list[Parameters]:
        size, duration_s = 0.01 * seen.span_um, seen.duration_s
        # Nothing warms up by itself within a tenth of a second.
        if size == 0 or duration_s < 0.1:
            return []
        return [
            {"rate_um_per_s": size / duration_s},
            {"amplitude_um": size, "time_constant_s": max(duration_s / 5, SLOWEST_DYNAMICS_S)},
            {"amplitude_um": size, "time_constant_s": max(duration_s, SLOWEST_DYNAMICS_S)},
        ]
