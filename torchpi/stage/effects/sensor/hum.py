"""Mains lines in the reading: y = x + Σ_k a_k cos 2πkft + b_k sin 2πkft, t from the first sample."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from torchpi.operators.base import StepStream
from torchpi.operators.quantity import Quantity
from torchpi.stage.effects.added_signal import AddedSignal
from torchpi.stage.effects.effect import DataRange, Parameters, parameter
from torchpi.stage.effects.oscillation import oscillation, oscillations

SIZES = ("cos_um", "sin_um", "cos2_um", "sin2_um", "cos3_um", "sin3_um")
"""a_k and b_k, one harmonic after another."""
MAINS_HZ = (50.0, 60.0, 100.0, 120.0, 150.0, 180.0)
STANDS_OUT = 3.0
"""A line gets a start if its amplitude exceeds the surrounding median by this factor."""


def hum_step(x: float, n: list[float], s: list[float]) -> float:
    """Return x plus the lines; n holds T, f and the amplitudes, s the samples since the first."""
    t_s, added = s[0] * n[0], 0.0
    for k in range(len(n) // 2 - 1):
        added += oscillation(t_s, (k + 1) * n[1], n[2 * k + 2], n[2 * k + 3])
    s[0] += 1.0
    return x + added


class Hum(AddedSignal):
    """One line of the mains, or of a multiple of it, alone or with its second and third harmonic; their
    phases differ between recordings."""

    name = "hum"
    block = "sensor"
    equation = "y = x + Σ_k a_k cos 2πkft + b_k sin 2πkft, k = 1 or k = 1 … 3"
    signature = "one exact spectral line, unrelated to the input's period, as large at rest as in motion"
    frequency_hz: nn.Parameter = parameter("Hz", at_least=45, at_most=400, identity=50.0)
    quantities: ClassVar[dict[str, Quantity]] = dict.fromkeys(SIZES, Quantity("µm", -1e3, 1e3))
    per_recording = SIZES
    forms = ("one line", "with harmonics")

    @classmethod
    def form(cls, values: Mapping[str, float]) -> str:
        if any(values.get(name) for name in SIZES[2:]):
            return "with harmonics"
        return "one line" if any(values.get(name) for name in SIZES[:2]) else ""

    def added(self, elapsed: Tensor, time: int) -> Tensor:
        added = elapsed.new_zeros(len(elapsed), time)
        for k, (cos, sin) in enumerate(self.lines(), 1):
            if torch.is_grad_enabled() or cos.item() or sin.item():
                f = k * self.frequency_hz
                added = added + oscillations(elapsed, time, self.sample_period_s, f, cos, sin)
        return added

    def lines(self) -> list[tuple[Tensor, Tensor]]:
        """Return a_k and b_k of each harmonic."""
        sizes = [getattr(self, name) for name in SIZES]
        return list(zip(sizes[::2], sizes[1::2], strict=True))

    def stream(self) -> nn.Module:
        sizes = (getattr(self, name).item() for name in SIZES)
        return StepStream(hum_step, [self.sample_period_s, self.frequency_hz.item(), *sizes], 1)

    @classmethod
    def line_hz(cls, values: Mapping[str, float]) -> float | None:
        return values["frequency_hz"]

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        # With less than a few periods a line is a drift; above half the sample rate it is aliased.
        size = 1e-3 * seen.span_um
        seen_lines = [f for f in MAINS_HZ if 3 / seen.duration_s < f < seen.fs_hz / 2 and size > 0]
        return [start for f in seen_lines for start in cls.starts_at(f, size, seen.fs_hz)]

    @classmethod
    def starts_at(cls, frequency_hz: float, size_um: float, fs_hz: float) -> list[Parameters]:
        """Return one line and, if the sample rate resolves them, one with its harmonics."""
        one = {"frequency_hz": frequency_hz, **dict.fromkeys(SIZES[:2], size_um)}
        return [one, {**one, **dict.fromkeys(SIZES[2:], size_um)}] if 6 * frequency_hz < fs_hz else [one]

    @classmethod
    def starts_from(
        cls, seen: DataRange, residual: np.ndarray, output: np.ndarray, fs_hz: float
    ) -> list[Parameters]:
        """Start at the residual's strongest frequency within 1 % of each visible line: the mains wander."""
        size, count = 1e-3 * seen.span_um, 1 << (4 * len(residual)).bit_length()
        f = np.fft.rfftfreq(count, 1 / fs_hz)
        power = np.abs(np.fft.rfft(residual * np.hanning(len(residual)), count))
        starts = []
        for mains in MAINS_HZ:
            near, around = np.abs(f - mains) < 0.01 * mains, np.abs(f - mains) < 0.2 * mains
            if not near.any() or size == 0 or 3 / seen.duration_s > mains:
                continue
            if power[near].max() > STANDS_OUT * np.median(power[around]):
                line = float(f[near][power[near].argmax()])
                starts += cls.starts_at(line, size, fs_hz)
        return starts
