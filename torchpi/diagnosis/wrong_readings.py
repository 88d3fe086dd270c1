"""Single wrong readings: find which outliers do not belong to the noise, however heavy its tails."""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import maximum_filter, median_filter, minimum_filter
from scipy.optimize import brentq
from scipy.special import pdtrc, stdtr, stdtrit

from torchpi.diagnosis.diagnosis import NamedEffect, Parameter
from torchpi.diagnosis.hypothesis import Fit
from torchpi.diagnosis.records import Record
from torchpi.recordings.faults import beside_steps, least_step, repeated_value, robust_sd
from torchpi.stage.effects.sensor.dropouts import Dropouts

LOST = 10.0
"""Multiple of the residual's rms by which a single wrong reading is off."""
ABOUT = 5
"""Number of samples before and after a reading with which it is compared."""
OTHERS = np.array([1, 1, 1, 0, 1, 1, 1])
"""The samples around a reading, without itself, with whose median it is compared."""
BESIDE = 32
"""Number of samples on either side of a reading from which the local model error is estimated."""
MOST = 0.5
"""Share of the readings that only the residual shows which must lie outside the recent motion."""
FALSE_ALARM = 1e-3
"""Probability that the tail of the noise alone contains so many readings so far out."""
BODY, TAIL = 0.5, 0.99
"""Quantiles of the residual, whose ratio determines the tail of a Student t."""
BEYOND = 30
"""Number of readings beyond a quantile from which that is known within a tenth."""
APART = 0.2
"""Largest ratio of what lies beyond two quantiles for a tail between them to be known."""
HEAVIEST, LIGHTEST = 1.0, 100.0
"""Bounds of the degrees of freedom of a Student t; at the upper one it is nearly normal."""
READ_OFF = 0.99
"""Probability assigned to what the readings themselves show."""


def wrong_readings(records: Sequence[Record], apart: Sequence[np.ndarray], final: Fit) -> list[np.ndarray]:
    """Return the wrong readings of each recording, (readings,): off by more than model error or noise there.

    Args:
        records: The recordings.
        apart: The readings that stand apart from their neighbours; in a fast motion many do not, and only
            the residual shows them.
        final: The fit whose residuals are examined.
    """
    # A model error is slow compared with a single reading and is not part of the noise's tail.
    alone = [np.abs(e - median_filter(e, footprint=OTHERS)) for e in final.residuals]
    usual = [usual_about(one) for one in alone]
    hidden = [
        np.setdiff1d(only_in_residual(record, one, LOST * about), raw)
        for record, one, about, raw in zip(records, alone, usual, apart, strict=True)
    ]
    suspects = [np.union1d(raw, more).astype(int) for raw, more in zip(apart, hidden, strict=True)]
    quiet_um = rms_without(final.residuals, suspects)
    each, rest = list[tuple[np.ndarray, np.ndarray, np.ndarray]](), []
    for i, (record, e, k) in enumerate(zip(records, final.residuals, suspects, strict=True)):
        off = off_all_around(record.y, e, k)
        there = off > LOST * np.maximum(error_about(e, k), quiet_um)
        same = np.isin(k, repeated_value(record.y, record.u, least_step(record.y)))
        only = np.isin(k, hidden[i])
        # One that lies where the stage has just been may be late; not so if most of the others lie outside.
        if only.any() and there[only].mean() > MOST:
            there, off = there | only, np.where(only, alone[i][k], off)
        each.append((k, same, np.where(there, off / usual[i][k], 0.0)))
        # Readings that stand out only from the residual may well be the tail of the noise.
        rest.append(np.delete(alone[i] / usual[i], k[(there | same) & ~only]))
    beyond = no_tail(np.concatenate([far for _, _, far in each]), np.concatenate(rest))
    return [k[same | (far >= beyond)] for k, same, far in each]


def without_outliers(residual: np.ndarray) -> np.ndarray:
    """(time,): a residual in which single outliers are replaced by the median of the samples around them."""
    about = median_filter(residual, footprint=OTHERS)
    alone = np.abs(residual - about)
    return np.where(alone > LOST * usual_about(alone), about, residual)


def rms_without(residuals: Sequence[np.ndarray], readings: Sequence[np.ndarray]) -> float:
    """µm: rms of these residuals, (time,) each, without these readings of each."""
    left = [np.delete(e, k) for e, k in zip(residuals, readings, strict=True)]
    return float(np.sqrt(np.mean(np.square(np.concatenate(left)))))


def no_tail(far: np.ndarray, rest: np.ndarray) -> float:
    """Return the size from which readings are not noise, because so many of that size are improbable.

    Args:
        far: (readings,) that may be wrong, in units of the usual size around each.
        rest: (samples,), the same for the other readings.
    """
    largest = np.sort(far[far > 0])[::-1]
    if not len(largest):
        return np.inf
    chances = pdtrc(np.arange(len(largest)), expected_beyond(largest, rest))
    unlikely = np.flatnonzero(chances < FALSE_ALARM / len(chances))
    return float(largest[unlikely[-1]]) if len(unlikely) else np.inf


def only_in_residual(record: Record, alone_um: np.ndarray, limit_um: np.ndarray) -> np.ndarray:
    """Return the (readings,) whose residual alone, of (samples,), µm, exceeds its limit and both neighbours'.

    Not where readings around it do not count, or where the input steps: the model may be wrong there.
    """
    counts = minimum_filter(record.train | record.held_out, 2 * ABOUT + 1)
    largest = maximum_filter(alone_um, 3) == alone_um
    found = np.flatnonzero(counts & largest & (alone_um > limit_um))
    return found[~beside_steps(found, record.u)] if len(found) else found


def usual_about(alone_um: np.ndarray) -> np.ndarray:
    """(samples,), µm: the median of these magnitudes, (samples,), µm, around each sample, or their overall
    median if that is larger: what is louder in one recording, or for a while, is not a tail either."""
    usual = max(float(np.median(alone_um)), 1e-300)
    about: np.ndarray = np.maximum(median_filter(alone_um, 2 * BESIDE + 1), usual)
    return about


def expected_beyond(limits: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Return how many of these errors, (samples,), lie beyond each limit if their tail goes on as it begins.

    Sensor noise with heavy tails is not rare: a few readings at ten times its rms are then noise. But the
    bursts of a motor's friction, which make a tail heavy, end. Where enough readings show that, their tail
    counts, unless it is heavier, as that of undetected wrong readings is.
    """
    outermost, quantiles = 1 - BEYOND / len(errors), [(BODY, TAIL)]
    if 1 - outermost < APART * (1 - TAIL):
        quantiles.append((TAIL, outermost))
    found: np.ndarray = np.min([of_student_t(limits, errors, *both) for both in quantiles], axis=0)
    return found


def of_student_t(limits: np.ndarray, errors: np.ndarray, inner: float, outer: float) -> np.ndarray:
    """Return how many of these errors, (samples,), a Student t with two of their quantiles has beyond each
    limit."""
    body, tail = np.quantile(errors, [inner, outer])
    if not 0 < body < tail:
        return np.zeros(len(limits))

    def ratio(freedom: float) -> float:
        of_body, of_tail = stdtrit(freedom, [0.5 + inner / 2, 0.5 + outer / 2])
        return float(np.log(of_tail / of_body) - np.log(tail / body))

    freedom = (
        LIGHTEST
        if ratio(LIGHTEST) > 0
        else HEAVIEST
        if ratio(HEAVIEST) < 0
        else float(brentq(ratio, HEAVIEST, LIGHTEST))
    )
    scale = body / stdtrit(freedom, 0.5 + inner / 2)
    beyond: np.ndarray = 2 * len(errors) * stdtr(freedom, -limits / scale)
    return beyond


def off_all_around(y: np.ndarray, residual: np.ndarray, readings: np.ndarray) -> np.ndarray:
    """(readings,), µm: how far each of these readings lies outside the range that the model covers around
    it. A jittering clock takes a reading early or late, but never where the stage has not been."""
    model = y - residual
    places = readings[:, None] + np.arange(-ABOUT, ABOUT + 1)
    passed = model[np.clip(places, 0, len(y) - 1)]
    found: np.ndarray = np.maximum(y[readings] - passed.max(1), passed.min(1) - y[readings])
    return found


def error_about(residual: np.ndarray, readings: np.ndarray) -> np.ndarray:
    """(readings,), µm: the model error before or after each of these readings, whichever is larger, as a
    standard deviation. Where the model misses a ring, the first swing is not a wrong reading."""
    places = readings[:, None] + np.arange(2, BESIDE + 2)
    sides = (places, 2 * readings[:, None] - places)
    before, after = (robust_sd(residual[np.clip(side, 0, len(residual) - 1)], axis=1) for side in sides)
    found: np.ndarray = np.maximum(before, after)
    return found


def of_dropouts(records: Sequence[Record], wrong: Sequence[np.ndarray], final: Fit) -> NamedEffect:
    """Report the single wrong readings as an effect: they are read off, not fitted."""
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
