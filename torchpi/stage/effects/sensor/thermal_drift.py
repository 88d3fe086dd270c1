"""Drift in absolute time, of a stage that warms up: y = x + A (1 - e^{-t/τ}) + ρ t, t from the first sample.

ΔL = L₀ α ΔT, where the temperature is that of one heat capacity behind one thermal resistance (A, τ), or is
still far from settling (ρ). That of a room wanders, and no equation predicts it: see
`torchpi.diagnosis.wandering`.
"""

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numba
import numpy as np
import torch
from torch import Tensor, nn

from torchpi.operators.base import StepStream
from torchpi.stage.effects.added_signal import AddedSignal, sampled
from torchpi.stage.effects.effect import DataRange, Parameters, parameter

QUICKEST = 0.01
"""Share of a recording: faster settling began before it and is not counted (`torchpi.diagnosis.start_up`)."""


def drift(t_s: float, amplitude_um: float, time_constant_s: float, rate_um_per_s: float) -> float:
    """Return A (1 - e^{-t/τ}) + ρ t."""
    return amplitude_um * (1.0 - math.exp(-t_s / time_constant_s)) + rate_um_per_s * t_s


def drift_step(x: float, n: list[float], s: list[float]) -> float:
    """Return x plus the drift; n holds T, A, τ and ρ, s the samples so far."""
    added = drift(s[0] * n[0], n[1], n[2], n[3])
    s[0] += 1.0
    return x + added


_drift: Any = numba.njit(drift)


@numba.njit(cache=True)
def _moved(
    elapsed: np.ndarray,
    period_s: float,
    amplitude_um: float,
    time_constant_s: float,
    rate_um_per_s: float,
    moved: np.ndarray,
) -> None:
    for batch in range(moved.shape[0]):
        for k in range(moved.shape[1]):
            t_s = (elapsed[batch] + k) * period_s
            moved[batch, k] = _drift(t_s, amplitude_um, time_constant_s, rate_um_per_s)


class ThermalDrift(AddedSignal):
    """A drift that settles, goes on, or both; how far is another number in each recording.

    The drift of one recording predicts nothing about the next, which has none without values of its own.
    """

    name = "thermal_drift"
    block = "sensor"
    equation = "y = x + A (1 - e^{-t/τ}), or + ρ t"
    signature = "slow, a function of absolute time: does not follow the last move"
    time_scale = "slow"
    degenerate_with = ("leakage", "creep")
    amplitude_um: nn.Parameter = parameter("µm", at_least=-1e4, at_most=1e4)
    time_constant_s: nn.Parameter = parameter("s", at_least=1e-5, at_most=1e6, identity=60.0)
    rate_um_per_s: nn.Parameter = parameter("µm/s", at_least=-1e3, at_most=1e3)
    forms = ("exponential", "linear")
    form_of: ClassVar[dict[str, str]] = {"amplitude_um": "exponential", "rate_um_per_s": "linear"}
    per_recording = ("amplitude_um", "rate_um_per_s")

    def added(self, elapsed: Tensor, time: int) -> Tensor:
        parameters = (self.amplitude_um, self.time_constant_s, self.rate_um_per_s)
        return sampled(_moved, self.of_tensors, elapsed, time, self.sample_period_s, parameters)

    def stream(self) -> nn.Module:
        parameters = (self.amplitude_um, self.time_constant_s, self.rate_um_per_s)
        return StepStream(drift_step, [self.sample_period_s, *(one.item() for one in parameters)], 1)

    @staticmethod
    def of_tensors(t_s: Tensor, a: Tensor, b: Tensor, c: Tensor) -> Tensor:
        return a * (1 - torch.exp(-t_s / b)) + c * t_s

    @classmethod
    def reached(cls, values: Mapping[str, float], seen: DataRange) -> bool:
        return values.get("time_constant_s", math.inf) >= QUICKEST * seen.duration_s

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        size, duration_s = 0.01 * seen.span_um, seen.duration_s
        if size == 0:
            return []
        return [
            {"rate_um_per_s": min(size / duration_s, cls.quantities["rate_um_per_s"].at_most)},
            *({"amplitude_um": size, "time_constant_s": part * duration_s} for part in (0.05, 0.2, 1.0)),
        ]
