"""The first mode of the mechanics: ẍ + 2ζω₀ẋ + ω₀²x = ω₀²x_in, ω₀ = 2πf₀.

Behind a simulation that already has a mode, with another frequency ω_r or damping ζ_r, it replaces that mode:
its transfer function is divided by that of the mode that it replaces,

    Y/X = (1 + 2ζ_r s/ω_r + s²/ω_r²) / (1 + 2ζ s/ω₀ + s²/ω₀²)
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from torchpi.operators.linear import Hold, Matrices, discretise
from torchpi.operators.quantity import Quantity
from torchpi.stage.effects.effect import DataRange, Parameters, StateSpaceEffect

TYPICAL_DAMPING = 0.02
BINS_PER_OCTAVE = 120
CLOSE, NEAR = 2.0, (0.93, 0.98, 1.02, 1.07)
"""The largest ratio of the frequencies of a mode and of the one that it replaces; the ratios that are tried
where both form a single peak."""
HIGHEST = 0.45
"""Highest frequency of a mode, as a share of the sample rate: between there and half of it, readings hardly
tell one frequency from another, nor from one above."""
GRID = 14
"""Number of frequencies of a blind search, close enough for a fit to converge."""
OF_A_MODE = {
    "frequency_hz": Quantity("Hz", at_least=1.0, at_most=1e5, identity=1000.0),
    # A mode with more damping does not visibly ring: it is a lag.
    "damping_ratio": Quantity("", at_least=1e-4, at_most=0.3, identity=TYPICAL_DAMPING),
}
FREQUENCY = replace(OF_A_MODE["frequency_hz"], identity=math.inf)


class Resonance(StateSpaceEffect):
    """A mode of unit static gain, exact for an input that runs straight from sample to sample, or is held."""

    name = "resonance"
    block = "mechanics"
    equation = "ẍ + 2ζω₀ẋ + ω₀²x = ω₀²x_in"
    signature = "rings at one frequency, phase lag grows towards it"
    time_scale = "fast"
    rings = True
    quantities: ClassVar[dict[str, Quantity]] = {
        **OF_A_MODE,
        "frequency_hz": FREQUENCY,
        "replaced_frequency_hz": FREQUENCY,
        "replaced_damping_ratio": OF_A_MODE["damping_ratio"],
    }
    accepted: ClassVar[dict[str, Quantity]] = {
        "frequency_hz": Quantity("Hz", at_least=0, positive=True),
        "damping_ratio": Quantity("", at_least=0),
    }
    forms: ClassVar[tuple[str, ...]] = ("one mode", "in place of the simulation's")
    frequency_hz: nn.Parameter
    damping_ratio: nn.Parameter
    replaced_frequency_hz: nn.Parameter
    replaced_damping_ratio: nn.Parameter
    order = 2
    hold: Hold = "first"

    @classmethod
    def form(cls, values: Mapping[str, float]) -> str:
        of = {**cls.identity, **values}
        if not cls.forms or math.isinf(of["frequency_hz"]):
            return ""
        return cls.forms[0] if math.isinf(of["replaced_frequency_hz"]) else cls.forms[1]

    def matrices(self) -> Matrices:
        if math.isinf(self.frequency_hz.item()):
            rest = self.frequency_hz.new_zeros(2)
            return rest.new_zeros(2, 2), rest, rest, rest.new_ones(())
        omega = 2 * math.pi * self.frequency_hz
        zero = torch.zeros_like(omega)
        # The second state is ẋ/ω₀: both are then of similar size, which keeps the exponential accurate.
        a = torch.stack([zero, omega, -omega, -2 * self.damping_ratio * omega]).reshape(2, 2)
        c, d = self.observed()
        return discretise(a, torch.stack([zero, omega]), c, d, self.sample_period_s, self.hold)

    def observed(self) -> tuple[Tensor, Tensor]:
        """Return C (2,) and D () of the mode, divided by the one that it replaces if there is one."""
        zero = torch.zeros_like(self.frequency_hz)
        replaces = "replaced_frequency_hz" in self.quantities
        if not replaces or math.isinf(self.replaced_frequency_hz.item()):
            return torch.stack([zero + 1, zero]), zero
        ratio = self.frequency_hz / self.replaced_frequency_hz
        damping = 2 * ratio * (self.replaced_damping_ratio - self.damping_ratio * ratio)
        return torch.stack([1 - ratio**2, damping]), ratio**2

    @classmethod
    def reached(cls, values: Mapping[str, float], seen: DataRange) -> bool:
        return is_sampled(values, seen)

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        highest = min(5e3, HIGHEST * seen.fs_hz)
        lowest = min(100.0, highest / 5)
        if lowest < cls.quantities["frequency_hz"].at_least:
            return []
        return [
            {**start, "damping_ratio": 0.05}
            for start in cls.starts_at(seen, np.geomspace(lowest, highest, GRID).tolist())
        ]

    @classmethod
    def starts_at(cls, seen: DataRange, frequencies_hz: list[float]) -> list[Parameters]:
        """Return starts at the given frequencies, such as `peaks_hz` of a residual; a grid is too coarse for
        a mode of little damping."""
        return [
            {"frequency_hz": f, "damping_ratio": TYPICAL_DAMPING}
            for f in frequencies_hz
            if f < 0.5 * seen.fs_hz
        ]

    @classmethod
    def starts_from(
        cls, seen: DataRange, residual: np.ndarray, output: np.ndarray, fs_hz: float
    ) -> list[Parameters]:
        peaks = peaks_hz(torch.from_numpy(residual), fs_hz)
        replaces = seen.simulated and "replaced_frequency_hz" in cls.quantities
        return cls.starts_at(seen, peaks) + (cls.starts_in_place(peaks) if replaces else [])

    @classmethod
    def starts_in_place(cls, frequencies_hz: list[float]) -> list[Parameters]:
        """Return starts of a mode in place of another; a residual shows both, or one peak for close ones."""
        pairs = [
            (a, b) for a in frequencies_hz for b in frequencies_hz if a != b and 1 / CLOSE < a / b < CLOSE
        ]
        pairs += [(f, f * near) for f in frequencies_hz for near in NEAR]
        return [
            {
                "frequency_hz": own,
                "damping_ratio": TYPICAL_DAMPING,
                "replaced_frequency_hz": replaced,
                "replaced_damping_ratio": TYPICAL_DAMPING,
            }
            for own, replaced in pairs
        ]


def peaks_hz(
    residual: Tensor,  # (time,), µm
    fs_hz: float,
    count: int = 4,
) -> list[float]:
    """Return where the spectrum of a residual stands out most from its surroundings, largest first.

    The surroundings are the median over an octave; peaks are at least a third of an octave apart, above
    100 Hz or a fiftieth of `fs_hz`, whichever is lower. Fewer than `count` if there are no more.
    """
    # Imported here, because the import takes half a second and a stage does not need it.
    import scipy.ndimage
    import scipy.signal

    # Segments short enough to average over several, long enough for a damping ratio below 1 %.
    segment = min(len(residual), max(len(residual) // 8, 1024), 16384)
    f, power = scipy.signal.welch(residual.detach().numpy(), fs_hz, nperseg=segment)
    lowest = min(100.0, fs_hz / 50)
    centres = np.geomspace(
        lowest, 0.45 * fs_hz, math.ceil(BINS_PER_OCTAVE * math.log2(0.45 * fs_hz / lowest))
    )
    level = np.interp(centres, f, np.log(power + np.finfo(float).tiny))
    excess = level - scipy.ndimage.median_filter(level, BINS_PER_OCTAVE + 1, mode="nearest")
    found, _ = scipy.signal.find_peaks(excess, distance=BINS_PER_OCTAVE // 3)
    peaks_hz: list[float] = centres[found[np.argsort(-excess[found])][:count]].tolist()
    return peaks_hz


def is_sampled(values: Mapping[str, float], seen: DataRange) -> bool:
    """Whether the readings are close enough in time to show a mode."""
    return values["frequency_hz"] < HIGHEST * seen.fs_hz
