"""Readings at the start of a recording in which the stage still settles from what came before it.

A generator that is switched on, or a step just before the first sample, moves the stage in a way that no
recorded voltage tells. The first reading itself is off then, which the response to a recorded command never
is.
"""

from collections.abc import Sequence

import numpy as np

from torchpi.diagnosis.records import Record
from torchpi.recordings.faults import robust_sd
from torchpi.stage.effects.sensor.thermal_drift import QUICKEST

LOUD, SETTLED = 10.0, 3.0
"""Times the usual error, by which the first reading is off, and within which the stage has settled."""
IN_A_ROW = 8
"""Readings that lie within that before the stage counts as settled."""


def unsettled(records: Sequence[Record], residuals: Sequence[np.ndarray]) -> tuple[int, ...]:
    """How many of the first readings of each recording are not to be counted.

    Args:
        records: The recordings.
        residuals: (time,) each, µm: what a model leaves of them.
    """
    return tuple(_unsettled(e, record.train) for record, e in zip(records, residuals, strict=True))


def _unsettled(e: np.ndarray, counts: np.ndarray) -> int:
    """The number of readings until a residual, (time,), stays within what is usual for it, and as many more;
    0 if it does from the start, or only much later."""
    if not counts[0]:
        return 0
    size = np.abs(e - np.median(e[counts]))
    usual = float(robust_sd(size[counts]))
    if not size[0] > LOUD * usual:
        return 0
    most = int(QUICKEST * len(e) / 2)  # what takes longer is a drift, creep or a wrong history
    within = size[: most + IN_A_ROW] < SETTLED * usual
    for k in range(1, most + 1):
        if within[k : k + IN_A_ROW].all():
            return 2 * k
    return 0
