"""The sensor's converter, read off the values on which all readings lie, not fitted."""

from collections.abc import Sequence

import numpy as np

from torchpi.diagnosis.diagnosis import NamedEffect, Parameter
from torchpi.diagnosis.hypothesis import Fit
from torchpi.diagnosis.wrong_readings import READ_OFF
from torchpi.recordings.recording import Recording
from torchpi.stage.effects.sensor.quantization import Codes, Quantization, half_width_um, uneven_codes

EVEN, UNEVEN = 1.01, 1.5
"""Largest ratio between the steps of recordings that one converter read, with even and with uneven codes."""
PRECISE = 1e-6
"""Least relative half-width of the interval of an even step."""


def converter(recordings: Sequence[Recording]) -> tuple[Codes, tuple[str, ...]]:
    """Return the values on which all readings lie, and a note; a step of 0 if there are none."""
    # One converter has the same values in all recordings; a single staircase passes only a few of them.
    each = [(one.readings, one.u) for one in recordings]
    y, u = map(np.concatenate, zip(*each, strict=True))
    for on_one_lattice in (each, [(y, u)]):
        if step := agreed([Quantization.lattice(*one) for one in on_one_lattice], EVEN):
            half_um = max(half_width_um(one, step) for one, _ in on_one_lattice)
            note = f"All readings lie on a grid with a step of {step * 1e3:.4g} nm."
            return Codes(step, max(half_um, PRECISE * step)), (note,)
    if (codes := uneven_codes(y, u)) is None:
        separate = [uneven_codes(*one) for one in each]
        if step := agreed([one and one.step_um for one in separate], UNEVEN):
            codes = Codes(step, max(one.half_width_um for one in separate if one))
    if codes is None:
        return Codes(0.0, 0.0), ()
    return codes, (
        "The readings recur on certain values, unevenly spaced, with a typical spacing of "
        f"{codes.step_um * 1e3:.4g} nm.",
    )


def agreed(steps: Sequence[float | None], ratio: float) -> float:
    """Return the median step of all recordings; 0 if one has none, or if they differ by more than `ratio`."""
    found = [step for step in steps if step is not None]
    return float(np.median(found)) if len(found) == len(steps) and max(found) <= ratio * min(found) else 0.0


def of_converter(codes: Codes, lsb_um: float, retuned: Fit) -> NamedEffect:
    """Return the converter as a named effect; its error is that of a step `lsb_um`."""
    step_um, half_um = codes
    return NamedEffect(
        Quantization.name,
        Quantization.block,
        (),
        READ_OFF,
        (Parameter("lsb_um", step_um, "µm", (step_um - half_um, step_um + half_um)),),
        min(1.0, lsb_um**2 / 12 / max(retuned.train_rms**2, 1e-300)),
        Quantization.equation,
        Quantization.signature,
        (),
    )
