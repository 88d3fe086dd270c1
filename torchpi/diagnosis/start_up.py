"""Find readings at the start of a recording in which the stage still settles from what came before it.

A generator that is switched on, or a step just before the first sample, moves the stage in a way that the
recorded voltage does not show. The very first reading is then off, which never happens in the response to a
recorded command.
"""

from collections.abc import Sequence

import numpy as np

from torchpi.diagnosis.records import Record
from torchpi.recordings.faults import robust_sd
from torchpi.stage.effects.sensor.thermal_drift import QUICKEST

LOUD, SETTLED = 10.0, 3.0
"""Multiples of the usual error that the first reading must exceed, and settled ones must stay below."""
IN_A_ROW = 8
"""Consecutive readings that must lie within that limit for the stage to count as settled."""


def unsettled(records: Sequence[Record], residuals: Sequence[np.ndarray]) -> tuple[int, ...]:
    """Return how many of the first readings of each recording must not be counted.

    Args:
        records: The recordings.
        residuals: (time,) each, µm: those of a model.
    """
    return tuple(_unsettled(e, record.train) for record, e in zip(records, residuals, strict=True))


def _unsettled(e: np.ndarray, counts: np.ndarray) -> int:
    """Return the number of readings until a residual, (time,), stays within its usual size, plus as many
    more; 0 if it does so from the start, or only much later."""
    if not counts[0]:
        return 0
    size = np.abs(e - np.median(e[counts]))
    usual = float(robust_sd(size[counts]))
    if not size[0] > LOUD * usual:
        return 0
    most = int(QUICKEST * len(e) / 2)  # anything slower is drift, creep or a wrong history
    within = size[: most + IN_A_ROW] < SETTLED * usual
    for k in range(1, most + 1):
        if within[k : k + IN_A_ROW].all():
            return 2 * k
    return 0
