"""Single wrong readings: which of those that stand out are no part of the noise, however heavy its tails."""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import median_filter
from scipy.optimize import brentq
from scipy.special import pdtrc, stdtr, stdtrit

from torchpi.diagnosis.diagnosis import NamedEffect, Parameter
from torchpi.diagnosis.hypothesis import Fit
from torchpi.diagnosis.records import Record
from torchpi.stage.effects.sensor.dropouts import Dropouts

LOST = 10.0
"""Times the rms of what is left, by which a single reading is off."""
ABOUT = 5
"""Samples before and after a reading that it is compared with."""
ALONE = 5
"""Samples about a reading whose median it is compared with."""
BESIDE = 32
"""Samples on either side of a reading from which the error of the model there is taken."""
FALSE_ALARM = 1e-3
"""The chance that the tail of the noise alone has so many readings so far out."""
BODY, TAIL = 0.5, 0.99
"""Quantiles of what is left, by whose ratio the tail of a Student t is known."""
HEAVIEST, LIGHTEST = 1.0, 100.0
"""Degrees of freedom of a Student t; from the more on it is all but normal."""
READ_OFF = 0.99
"""Probability of what the readings themselves show."""


def wrong_readings(records: Sequence[Record], apart: Sequence[np.ndarray], final: Fit) -> list[np.ndarray]:
    """(readings,) of each recording that are off by more than the model, or the noise, is there.

    Args:
        records: The recordings.
        apart: The readings that stand apart from their neighbours.
        final: What is left by it.
    """
    lost, off_um = [], []
    for record, e, k in zip(records, final.residuals, apart, strict=True):
        off = off_all_around(record.y, e, k)
        there = off > LOST * np.maximum(error_about(e, k), final.train_rms)
        lost.append(k[there])
        off_um += off[there].tolist()
    # What the model has wrong is slow beside a single reading: it is no tail of the noise.
    alone = [e - median_filter(e, ALONE) for e in final.residuals]
    rest = np.concatenate([np.delete(e, k) for e, k in zip(alone, lost, strict=True)])
    if off_um and pdtrc(len(off_um) - 1, expected_beyond(min(off_um), np.abs(rest))) < FALSE_ALARM:
        return lost
    return [k[:0] for k in lost]


def expected_beyond(limit_um: float, error_um: np.ndarray) -> float:
    """How many of these errors, (samples,), µm, a Student t of their body and tail has beyond a limit.

    Sensors whose noise has heavy tails are no rarity: a few readings at ten times its rms are then noise.
    """
    body, tail = np.quantile(error_um, [BODY, TAIL])
    if not 0 < body < tail:
        return 0.0

    def ratio(freedom: float) -> float:
        inner, outer = stdtrit(freedom, [0.5 + BODY / 2, 0.5 + TAIL / 2])
        return float(np.log(outer / inner) - np.log(tail / body))

    freedom = (
        LIGHTEST if ratio(LIGHTEST) > 0 else 1.0 if ratio(1.0) < 0 else float(brentq(ratio, 1.0, LIGHTEST))
    )
    scale_um = body / stdtrit(freedom, 0.5 + BODY / 2)
    return float(2 * len(error_um) * stdtr(freedom, -limit_um / scale_um))


def off_all_around(y: np.ndarray, residual: np.ndarray, readings: np.ndarray) -> np.ndarray:
    """(readings,), µm: by how much each of these readings lies beyond everything that the model passes about
    it. A clock that jitters takes a reading early or late, but nowhere that the stage has not been."""
    model = y - residual
    places = readings[:, None] + np.arange(-ABOUT, ABOUT + 1)
    passed = model[np.clip(places, 0, len(y) - 1)]
    found: np.ndarray = np.maximum(y[readings] - passed.max(1), passed.min(1) - y[readings])
    return found


def error_about(residual: np.ndarray, readings: np.ndarray) -> np.ndarray:
    """(readings,), µm: the error of the model before or after each of these readings, the larger, as a
    standard deviation. Where the model misses a ring, its first swing is no wrong reading."""
    places = readings[:, None] + np.arange(2, BESIDE + 2)
    sides = (places, 2 * readings[:, None] - places)
    medians = [np.median(np.abs(residual[np.clip(side, 0, len(residual) - 1)]), axis=1) for side in sides]
    found: np.ndarray = 1.4826 * np.maximum(*medians)
    return found


def of_dropouts(records: Sequence[Record], wrong: Sequence[np.ndarray], final: Fit) -> NamedEffect:
    """Single wrong readings: each is seen, and none is fitted."""
    off = [e[k] for e, k in zip(final.residuals, wrong, strict=True)]
    samples, count = sum(len(r.y) for r in records), sum(len(k) for k in wrong)
    squares = float(np.square(np.concatenate(off)).sum())
    rest = sum(float(e @ e) for e in final.residuals)
    return NamedEffect(
        Dropouts.name,
        Dropouts.block,
        (),
        READ_OFF,
        (Parameter("share", count / samples, "", None),),
        squares / max(rest, 1e-300),
        Dropouts.equation,
        Dropouts.signature,
        (),
    )
