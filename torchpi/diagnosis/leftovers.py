"""Features that stand out of the final residual, named or not: a stretch of time, a tone, a recording."""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import median_filter

from torchpi.diagnosis.lines import AROUND, periodogram
from torchpi.diagnosis.records import Record

LOUD = 10.0
"""Multiple of the rms of the rest from which a feature stands out."""
STRETCHES = 50
"""Number of stretches of a recording that are compared with one another."""
TONE = 0.1
"""Share of a recording's mean square that one frequency must hold to count as a tone."""
AT_MOST = 3
"""Maximum number of phrases."""


def leftovers(records: Sequence[Record], residuals: Sequence[np.ndarray]) -> tuple[str, ...]:
    """Return a phrase for each recording, stretch or frequency that stands out of the model's residual.

    The loudest comes first.

    Args:
        records: The recordings.
        residuals: (time,) each, µm.
    """
    found: list[tuple[float, str]] = []
    # Wrong readings and an unsettled start do not count here; they are reported elsewhere.
    residuals = [np.where(r.train | r.held_out, e, 0.0) for r, e in zip(records, residuals, strict=True)]
    squares = [float(np.mean(e**2)) for e in residuals]
    for record, e, own in zip(records, residuals, squares, strict=True):
        others = [square for other, square in zip(records, squares, strict=True) if other is not record]
        if others and own > LOUD**2 * max(float(np.median(others)), 1e-300):
            found.append(
                (own, f"recording {record.name}, {np.sqrt(own / np.median(others)):.0f} times the others")
            )
        parts = np.array_split(e, min(STRETCHES, len(e)))
        each = np.array([float(np.mean(part**2)) for part in parts])
        place, typical = int(each.argmax()), max(float(np.median(each)), 1e-300)
        if each[place] > LOUD**2 * typical:
            width = len(e) / len(parts) / record.fs_hz
            found.append(
                (
                    each[place],
                    f"{record.name} from {place * width:.3g} s to {(place + 1) * width:.3g} s, "
                    f"{np.sqrt(each[place] / typical):.0f} times the rest",
                )
            )
        power = periodogram(e - e.mean())
        if len(power) <= AROUND:
            continue
        around = median_filter(power, AROUND, mode="reflect") + 1e-300
        peak = int(np.argmax(np.where(power > LOUD**2 * around, power, 0.0)[4:])) + 4
        share = float(power[max(peak - 2, 0) : peak + 3].sum() / max(power.sum(), 1e-300))
        if power[peak] > LOUD**2 * around[peak] and share > TONE:
            hz = peak * record.fs_hz / len(e)
            found.append(
                (share * own, f"{record.name} at {hz:.3g} Hz, {100 * share:.0f} % of the residual there")
            )
    return tuple(phrase for _, phrase in sorted(found, reverse=True)[:AT_MOST])
