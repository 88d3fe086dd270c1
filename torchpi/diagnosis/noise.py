"""The noise floor, from where nothing moves: rests of the input long enough for the stage to settle."""

from collections.abc import Sequence

import numpy as np

from torchpi.diagnosis.records import Record

LEAST_REST = 200
"""Samples of a rest from which a level is taken."""


def noise_floor_um(records: Sequence[Record], lsb_um: float = 0.0) -> float | None:
    """Standard deviation of the readings about a slow curve over each rest; None where there is no rest.

    The first half of a rest belongs to what came before it; a cubic takes creep out of the other. Readings
    on a lattice of `lsb_um` rest on one of its lines: its own noise, uniform, comes on top.
    """
    squares, degrees = 0.0, 0
    for record in records:
        edges = np.flatnonzero(np.diff(record.u) != 0) + 1
        for part in np.split(record.y, edges):
            rest = part[len(part) // 2 :]
            if len(rest) < LEAST_REST // 2:
                continue
            x = np.linspace(-1, 1, len(rest))
            fitted = np.polynomial.polynomial.polyval(x, np.polynomial.polynomial.polyfit(x, rest, 3))
            squares += float(((rest - fitted) ** 2).sum())
            degrees += len(rest) - 4
    return float(np.sqrt(squares / degrees + lsb_um**2 / 12)) if degrees else None
