"""The noise floor, from where nothing moves: rests of the input long enough for the stage to settle."""

from collections.abc import Sequence

import numpy as np

from torchpi.diagnosis.multisine import periodic_stretches
from torchpi.diagnosis.records import Record

LEAST_REST = 200
"""Samples of a rest from which a level is taken."""


def noise_floor_um(records: Sequence[Record], lsb_um: float = 0.0) -> float | None:
    """The noise of one reading: from rests where there are any, else from repeats; None without both."""
    rests = of_rests(records)
    found = rests if rests is not None else of_repeats(records)
    # Readings on a lattice rest on one of its lines: its own noise, uniform, comes on top.
    return None if found is None else float(np.hypot(found, lsb_um / np.sqrt(12)))


def of_repeats(records: Sequence[Record]) -> float | None:
    """From the difference of the last two periods of an input that repeats itself."""
    squares, count = 0.0, 0
    for record in records:
        for stretch in periodic_stretches(record.u):
            end = stretch.start + stretch.periods * stretch.period
            last, before = record.y[end - stretch.period : end], record.y[: end - stretch.period]
            squares += float(((last - before[-stretch.period :]) ** 2).sum()) / 2
            count += stretch.period
    return float(np.sqrt(squares / count)) if count else None


def of_rests(records: Sequence[Record]) -> float | None:
    """Standard deviation of the readings about a slow curve over each rest; None where there is no rest.

    The first half of a rest belongs to what came before it; a cubic takes creep out of the other.
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
    return float(np.sqrt(squares / degrees)) if degrees else None
