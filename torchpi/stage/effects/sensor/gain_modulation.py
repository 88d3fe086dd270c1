"""A slow signal that the voltage does not drive: y = x [1 + m(t)] + a(t), t from the first sample.

The light source of an interferometer or a reference voltage fluctuates (m), or a mount sways (a), with a line
of 0.02 to 20 Hz. No equation predicts what has no fixed frequency: see `torchpi.diagnosis.wandering`.
Fleming, *A review of nanometer-resolution position sensors: operation and performance*, Sensors and Actuators
A 190, 2013: drift of gain and of offset.
"""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from torchpi.operators.base import StepStream
from torchpi.stage.effects.added_signal import InTime
from torchpi.stage.effects.effect import DataRange, Parameters, parameter
from torchpi.stage.effects.oscillation import oscillation, oscillations

STARTS_HZ = (0.02, 0.06, 0.2, 0.6, 2.0, 6.0, 20.0)
STANDS_OUT, AROUND = 6.0, 101
"""A displacement has a line where its amplitude exceeds the median of so many frequencies by this factor."""
DENSE = 4
"""Oversampling of the frequencies that a record resolves: a line lies within an eighth of 1/duration."""
FEWEST_PERIODS = 2.0
"""Least periods of a line in the longest recording; fewer are a drift or a gain that differs by recording."""


def modulation_step(x: float, n: list[float], s: list[float]) -> float:
    """Return x modulated; n holds T, f, and both amplitudes of the gain's line and of the zero's, s the
    samples so far."""
    t_s = s[0] * n[0]
    gain = 1.0 + oscillation(t_s, n[1], n[2], n[3])
    s[0] += 1.0
    return x * gain + oscillation(t_s, n[1], n[4], n[5])


class GainModulation(InTime):
    """A gain, or a zero, that moves by itself; how far is another number in each recording."""

    name = "gain_modulation"
    block = "sensor"
    equation = "y = x [1 + a cos 2πft + b sin 2πft], or x + a line"
    signature = (
        "an error in proportion to the displacement and to a slow signal that does not follow the voltage"
    )
    time_scale = "slow"
    degenerate_with = ("ageing",)
    frequency_hz: nn.Parameter = parameter("Hz", at_least=1e-3, at_most=45.0, identity=1.0)
    cos: nn.Parameter = parameter("", at_least=-0.9, at_most=0.9)
    sin: nn.Parameter = parameter("", at_least=-0.9, at_most=0.9)
    cos_um: nn.Parameter = parameter("µm", at_least=-1e3, at_most=1e3)
    sin_um: nn.Parameter = parameter("µm", at_least=-1e3, at_most=1e3)
    forms = ("multiplicative", "additive")
    form_of: ClassVar[dict[str, str]] = {
        **dict.fromkeys(("cos", "sin"), "multiplicative"),
        **dict.fromkeys(("cos_um", "sin_um"), "additive"),
    }
    per_recording = ("cos", "sin", "cos_um", "sin_um")

    def gain(self, elapsed: Tensor, time: int) -> Tensor:
        """Return 1 + m, (batch, time)."""
        return 1 + oscillations(elapsed, time, self.sample_period_s, self.frequency_hz, self.cos, self.sin)

    def forward(
        self,
        x: Tensor,  # (batch, time), µm
        state: Tensor | None = None,  # (batch, 1), samples
    ) -> tuple[Tensor, Tensor]:
        elapsed = self.initial_state(len(x)) if state is None else state
        time = x.shape[1]
        added = oscillations(elapsed, time, self.sample_period_s, self.frequency_hz, self.cos_um, self.sin_um)
        return x * self.gain(elapsed, time).to(x) + added.to(x), elapsed + time

    def stream(self) -> nn.Module:
        lines = (self.frequency_hz, self.cos, self.sin, self.cos_um, self.sin_um)
        return StepStream(modulation_step, [self.sample_period_s, *(one.item() for one in lines)], 1)

    @torch.no_grad()
    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        return dx * self.gain(self.initial_state(1), dx.shape[1])

    @classmethod
    def line_hz(cls, values: Mapping[str, float]) -> float | None:
        return values.get("frequency_hz")

    @classmethod
    def added_line_hz(cls, values: Mapping[str, float]) -> float | None:
        return values.get("frequency_hz") if {"cos_um", "sin_um"} & values.keys() else None

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        if seen.span_um == 0:
            return []
        return cls.starts_at(seen, STARTS_HZ, STARTS_HZ)

    @classmethod
    def starts_at(
        cls, seen: DataRange, modulating_hz: Sequence[float], added_hz: Sequence[float]
    ) -> list[Parameters]:
        """Return starts at the given frequencies, such as `modulation_hz` and `lines_hz` of a residual.

        In a record of D seconds a fit converges to a frequency from about 1/D away, so a grid is too coarse
        for a line of many periods.
        """
        size, bounds = 0.01 * seen.span_um, cls.quantities["frequency_hz"]
        low_hz = max(bounds.at_least, FEWEST_PERIODS / seen.duration_s)
        high_hz = min(bounds.at_most, seen.fs_hz / 2)
        lines = [("cos", "sin", 0.01, f) for f in modulating_hz]
        lines += [("cos_um", "sin_um", size, f) for f in added_hz if size > 0]
        return [{"frequency_hz": f, cos: one, sin: one} for cos, sin, one, f in lines if low_hz < f < high_hz]

    @classmethod
    def starts_from(
        cls, seen: DataRange, residual: np.ndarray, output: np.ndarray, fs_hz: float
    ) -> list[Parameters]:
        modulating_hz = modulation_hz(residual, output, fs_hz, 2)
        return cls.starts_at(seen, modulating_hz, lines_hz(residual, output - residual, fs_hz, 2))


def modulation_hz(
    residual: np.ndarray,  # (time,), µm
    displacement: np.ndarray,  # (time,), µm, the reading or the model's
    fs_hz: float,
    count: int = 4,
) -> list[float]:
    """Return the lines that explain most of a residual when they modulate the displacement, best first.

    The explained share is that of a least-squares fit of x cos and x sin, to first order in 1/time (Lomb,
    *Least-squares frequency analysis of unequally spaced data*, Astrophysics and Space Science 39, 1976, with
    x as weight). Fewer than `count` if there are no more from two periods in the record to 20 Hz.
    """
    # Imported here, because the import takes half a second and a stage does not need it.
    import scipy.fft

    product = residual * displacement
    # A part in proportion to the displacement itself is a gain error, not a modulation.
    power = displacement**2
    product = product - power * (product.sum() / max(power.sum(), np.finfo(float).tiny))
    size = scipy.fft.next_fast_len(DENSE * len(product), real=True)
    explained, f = np.abs(np.fft.rfft(product, size)), np.fft.rfftfreq(size, 1 / fs_hz)
    return highest_peaks(explained, f, FEWEST_PERIODS * fs_hz / len(product), DENSE, count)


def lines_hz(
    residual: np.ndarray,  # (time,), µm
    displacement: np.ndarray,  # (time,), µm, the model's
    fs_hz: float,
    count: int = 4,
) -> list[float]:
    """Return the largest lines of a residual where the displacement has none, since remainders of a command
    that is a sum of sines may be larger. Fewer than `count` are returned if there are no more from two
    periods in the record to 20 Hz."""
    import scipy.fft
    import scipy.ndimage

    window, size = np.hanning(len(residual)), scipy.fft.next_fast_len(DENSE * len(residual), real=True)
    f = np.fft.rfftfreq(size, 1 / fs_hz)
    slow = f <= 2 * STARTS_HZ[-1]
    left, moved = (np.abs(np.fft.rfft((x - x.mean()) * window, size))[slow] for x in (residual, displacement))
    f = f[slow]
    quiet = moved <= STANDS_OUT * scipy.ndimage.median_filter(moved, DENSE * AROUND, mode="reflect")
    return highest_peaks(left * quiet, f, FEWEST_PERIODS * fs_hz / len(residual), 4 * DENSE, count)


def highest_peaks(
    height: np.ndarray,  # (frequencies,)
    f: np.ndarray,  # (frequencies,), Hz
    low_hz: float,
    apart: int,
    count: int,
) -> list[float]:
    """Return the frequencies of the highest peaks from `low_hz` to 20 Hz, at least `apart` bins apart."""
    import scipy.signal

    height = np.where((f >= low_hz) & (f <= STARTS_HZ[-1]), height, 0.0)
    found, _ = scipy.signal.find_peaks(height, distance=apart)
    highest: list[float] = f[found[np.argsort(-height[found])][:count]].tolist()
    return highest
