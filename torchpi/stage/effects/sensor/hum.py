"""A mains line in the reading: y = x + a cos 2πft + b sin 2πft, t from the first sample."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from torch import nn

from torchpi.operators.quantity import Quantity
from torchpi.stage.effects.added_signal import AddedSignal
from torchpi.stage.effects.effect import DataRange, Parameters
from torchpi.stage.effects.oscillation import fill_line, oscillation, oscillation_of_tensors

MAINS_HZ = (50.0, 60.0, 100.0, 120.0, 150.0, 180.0)
STANDS_OUT = 3.0
"""Times the median amplitude around it, from which a line is worth a start."""


class Hum(AddedSignal):
    """One line of the mains, or of a multiple of it; its phase is another one in each recording."""

    name = "hum"
    block = "sensor"
    equation = "y = x + a cos 2πft + b sin 2πft"
    signature = "one exact line, not periodic with the input, of one size in motion and at rest"
    quantities: ClassVar[dict[str, Quantity]] = {
        "frequency_hz": Quantity("Hz", at_least=45, at_most=400),
        "cos_um": Quantity("µm", at_least=-1e3, at_most=1e3),
        "sin_um": Quantity("µm", at_least=-1e3, at_most=1e3),
    }
    identity: ClassVar[Parameters] = {"frequency_hz": 50.0, "cos_um": 0.0, "sin_um": 0.0}
    per_recording = ("cos_um", "sin_um")
    signal, kernel = staticmethod(oscillation), staticmethod(fill_line)
    of_tensors = staticmethod(oscillation_of_tensors)
    frequency_hz: nn.Parameter
    cos_um: nn.Parameter
    sin_um: nn.Parameter

    @classmethod
    def line_hz(cls, values: Mapping[str, float]) -> float | None:
        return values["frequency_hz"]

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        # Below a few periods a line is a drift; above half of the sample rate it shows as another one.
        size = 1e-3 * seen.span_um
        seen_lines = [f for f in MAINS_HZ if 3 / seen.duration_s < f < seen.fs_hz / 2 and size > 0]
        return [{"frequency_hz": f, "cos_um": size, "sin_um": size} for f in seen_lines]

    @classmethod
    def starts_from(
        cls, seen: DataRange, residual: np.ndarray, output: np.ndarray, fs_hz: float
    ) -> list[Parameters]:
        """At the strongest frequency of the residual within 1 % of each line that shows: the mains wander."""
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
                starts.append({"frequency_hz": line, "cos_um": size, "sin_um": size})
        return starts
