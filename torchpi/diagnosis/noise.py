"""The noise of a reading, from data in which nothing else happens; never from the residual of a fit."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from torchpi.diagnosis.coefficients import Coefficients
from torchpi.diagnosis.haar import Haar
from torchpi.diagnosis.lines import without_lines
from torchpi.diagnosis.records import Record
from torchpi.diagnosis.repeats import SAME

LEAST_HOLD = 200
"""Samples of a hold from which a level is taken."""
BEFORE_A_STEP = 2
"""Samples at the end of a hold that are none of it: where samples were resampled, or read late, a reading
may lie behind the step that ends it."""
STILL, SMALL = (0.5, 1.5), 0.005
"""Von Neumann's ratio of a monitored voltage that holds: half the mean squared successive difference over the
variance is 1 for white noise, and small where it moves; and its standard deviation, of the span."""
LEAST_PERIODS = 3
"""Of an input that repeats: the first still has the transient of the start."""
LEAST_COEFFICIENTS = 8
"""Of a scale from which its variance is taken; the next slower ones are extrapolated."""
STEEPEST = 1.5
"""Slope of an extrapolated spectrum, as 1/f to this power."""
STEEPER, WANDERS = 2.0, 3
"""By which the variance grows from one scale to the next slower one in noise of 1/f; steps of more, up to the
slowest scale, that are no noise any more."""


@dataclass(frozen=True, eq=False)
class Noise:
    """What was measured of the noise."""

    rms_um: float
    """Of one reading."""
    variance_um2: np.ndarray
    """(levels,): of a Haar coefficient on each scale, the fastest first; the last one's slope goes on."""
    fs_hz: float
    """Of the recordings that it was measured in."""
    source: str
    """What it was measured from."""
    lsb_um: float = 0.0
    """The step of the lattice on which the readings lie, where there is one."""
    monitor_um_per_v: float = 0.0
    """What the noise of the voltage's monitor makes of a prediction, where it was monitored."""

    def level_um2(self, level: int) -> float:
        """The variance on a scale, 1 for differences of neighbours."""
        known = self.variance_um2
        if level <= len(known):
            return float(known[level - 1])
        last = np.log2(known[-3:])
        slope = float(np.clip(np.diff(last).mean(), 0.0, STEEPEST)) if len(last) > 1 else 0.0
        return float(known[-1] * 2 ** (slope * (level - len(known))))

    def with_converter(self, lsb_um: float) -> "Noise":
        """The same where readings lie on a lattice: a hold may stay on one line of it."""
        own = lsb_um**2 / 12
        rms_um = float(np.hypot(self.rms_um, np.sqrt(own)))
        return replace(self, rms_um=rms_um, variance_um2=self.variance_um2 + own, lsb_um=lsb_um)

    def with_monitor(self, records: Sequence[Record], um_per_v: float) -> "Noise":
        """The same where a voltage was monitored: where it moves too fast to tell its noise from it, a
        prediction has that noise, times the gain, which no model of the stage explains."""
        left_v = [record.monitor_noise_left_v[record.train] for record in records]
        own_um = um_per_v * float(np.sqrt((np.concatenate(left_v) ** 2).mean()))
        if own_um == 0.0:
            return self
        source = f"{self.source} and in the monitored voltage"
        rms_um = float(np.hypot(self.rms_um, own_um))
        return replace(self, rms_um=rms_um, source=source, monitor_um_per_v=um_per_v)


def held_error(y: np.ndarray, of: Coefficients) -> np.ndarray:
    """(cells,): the mean square of the coefficients that a converter's error has, over that of white error.

    The error of readings that stay on one line of a lattice for R samples is one error, not R independent
    ones. With the autocovariance 1 - |τ|/R of runs of R samples, a Haar coefficient on the scale of n samples
    has n²/6R times the variance of white error where n is small against R, and R times where it is large.

    Args:
        y: (time,), readings on a lattice.
        of: The coefficients of them.
    """
    edges = np.flatnonzero(np.diff(y[: of.samples])) + 1
    lengths = np.diff([0, *edges.tolist(), of.samples])
    run = np.repeat(lengths, lengths).astype(float)[of.at]
    times = np.minimum(of.scale**2 / (6 * run), run)
    found: np.ndarray = np.bincount(of.cell, np.maximum(times, 1.0)) / np.bincount(of.cell)
    return found


def noise_of_prediction(
    records: Sequence[Record],
    lsb_um: float,
    um_per_v: float,
    residuals: Sequence[np.ndarray] | None = None,
) -> Noise | None:
    """What was measured, with the error of a converter and what the monitor of the voltage adds.

    Args:
        records: The recordings.
        lsb_um: The step of the lattice on which the readings lie; 0 where there is none.
        um_per_v: The gain.
        residuals: (time,) each: of a simulation, in place of the readings.
    """
    found = measured_noise(records, residuals)
    return found and found.with_converter(lsb_um).with_monitor(records, um_per_v)


def measured_noise(records: Sequence[Record], residuals: Sequence[np.ndarray] | None = None) -> Noise | None:
    """From holds of the command where there are any, else from repeats of it, within a recording or from one
    to another; None without all three.

    Args:
        records: The recordings.
        residuals: (time,) each: of a simulation, in place of the readings. They have the noise of a
            monitored voltage as well.
    """
    readings = residuals or [record.y for record in records]
    records = [replace(record, y=bridged(y, record)) for record, y in zip(records, readings, strict=True)]
    sources = (
        ("holds of the voltage", of_holds),
        ("periods that repeat, the first left out", of_repeats),
        ("recordings of the same voltage", of_second_recordings),
    )
    for source, pieces in sources:
        found = [(record, list(pieces(record, records))) for record in records]
        longest = max((r.fs_hz for r, parts in found if parts), default=None)
        used = [part for record, parts in found if record.fs_hz == longest for part in parts]
        if used:
            assert longest is not None
            found_here = spectrum_of(used)
            # A hold has been freed of what moves slowly.
            rms_um, variance = found_here if pieces is of_holds else without_wander(*found_here)
            if rms_um > 0:
                return Noise(rms_um, variance, longest, source)
    return None


def bridged(y: np.ndarray, record: Record) -> np.ndarray:
    """(time,): straight across the wrong readings of a recording, which are no noise."""
    valid = record.train | record.held_out
    k = np.arange(len(y))
    return y if valid.all() else np.interp(k, k[valid], y[valid])


def spectrum_of(pieces: Sequence[np.ndarray]) -> tuple[float, np.ndarray]:
    """Rms, and (levels,) the variance of a Haar coefficient, of pieces of noise, (time,) each."""
    squares, counts = np.zeros(40), np.zeros(40)
    for piece in pieces:
        haar = Haar.of(piece, len(piece), np.ones(len(piece), bool), len(piece))
        full = haar.full(piece[None])[0]
        for level in range(1, haar.levels + 1):
            first, stop = haar.places(level)
            stop = first + len(piece) // 2**level  # beyond it, padding
            squares[level - 1] += float((full[first:stop] ** 2).sum())
            counts[level - 1] += stop - first
    known = counts >= LEAST_COEFFICIENTS
    known[int(np.argmin(known)) :] = False
    rms_um = float(np.sqrt(sum(float(p @ p) for p in pieces) / sum(len(p) for p in pieces)))
    if not known.any():
        return rms_um, np.array([rms_um**2])
    variance = squares[known] / counts[known]
    # Readings on a lattice differ by nothing at all for long.
    return rms_um, np.maximum(variance, 1e-4 * rms_um**2)


def without_wander(rms_um: float, variance: np.ndarray) -> tuple[float, np.ndarray]:
    """The same without what grows faster than 1/f towards the slowest scales, as a random walk does.

    That is drift, and no noise: on the scales of it noise stays as it is on the fastest of them. A sensor's
    low-pass makes noise grow as well, but on the fast scales.
    """
    steep = variance[1:] > STEEPER * variance[:-1]
    still = np.flatnonzero(~steep)
    first = int(still[-1]) + 1 if len(still) else len(steep)  # the scale from which it grows to the end
    if len(steep) - first < WANDERS:
        return rms_um, variance
    less = np.minimum(variance, np.where(np.arange(len(variance)) > first, variance[first], np.inf))
    share = 0.5 ** np.arange(1, len(less) + 1)
    return float(np.sqrt(less @ share + less[-1] * share[-1])), less


def of_holds(record: Record, records: Sequence[Record]) -> Iterator[np.ndarray]:
    """The second half of each hold, less a cubic that takes creep out of it and less its lines."""
    for hold in holds(record.u):
        half = record.y[(hold.start + hold.stop) // 2 : hold.stop - BEFORE_A_STEP]
        x = np.linspace(-1, 1, len(half))
        smooth = np.polynomial.polynomial.polyval(x, np.polynomial.polynomial.polyfit(x, half, 3))
        yield without_lines((half - smooth) * np.sqrt(len(half) / (len(half) - 4)))


def holds(u: np.ndarray) -> list[slice]:
    """Where a voltage holds, `LEAST_HOLD` samples or more: commanded, or monitored with noise of its own."""
    span = float(np.ptp(u))
    edges = np.flatnonzero(np.diff(u) != 0) + 1
    found = [
        slice(start, stop)
        for start, stop in zip([0, *edges.tolist()], [*edges.tolist(), len(u)], strict=True)
        if stop - start >= LEAST_HOLD
    ]
    if found or span == 0.0:
        return found
    start = 0
    while start + LEAST_HOLD <= len(u):
        stop = start + LEAST_HOLD
        if not _still(u[start:stop], span):
            start += LEAST_HOLD // 4
            continue
        while stop < len(u) and _still(u[start : min(stop + LEAST_HOLD, len(u))], span):
            stop = min(stop + LEAST_HOLD, len(u))
        found.append(slice(start, stop))
        start = stop
    return found


def _still(u: np.ndarray, span: float) -> bool:
    variance = float(u.var())
    ratio = float((np.diff(u) ** 2).mean()) / 2 / max(variance, 1e-300)
    return variance < (SMALL * span) ** 2 and (variance == 0.0 or STILL[0] < ratio < STILL[1])


def of_repeats(record: Record, records: Sequence[Record]) -> Iterator[np.ndarray]:
    """Differences of neighbouring periods, over root two, each less its own line."""
    for stretch in record.coefficients.repeats.periodic:
        if stretch.periods >= LEAST_PERIODS:
            periods = record.y[stretch.start : stretch.end].reshape(stretch.periods, stretch.period)
            for before, after in pairwise(periods[1:]):
                yield _straightened(after - before) / np.sqrt(2)


def of_second_recordings(record: Record, records: Sequence[Record]) -> Iterator[np.ndarray]:
    """The difference to a later recording of the same voltage, its first half left out."""
    place = next(i for i, one in enumerate(records) if one is record)
    for other in records[place + 1 :]:
        same = other.fs_hz == record.fs_hz and len(other.u) == len(record.u)
        if same and np.abs(other.u - record.u).max() <= SAME * np.ptp(record.u):
            yield _straightened((other.y - record.y)[len(record.y) // 2 :]) / np.sqrt(2)


def _straightened(x: np.ndarray) -> np.ndarray:
    """Less its mean and slope."""
    t = np.linspace(-1, 1, len(x))
    straight: np.ndarray = x - x.mean() - t * (t @ x) / (t @ t)
    return straight
