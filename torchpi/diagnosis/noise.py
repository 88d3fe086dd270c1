"""Noise of a reading, estimated from data in which nothing else happens; never from the residual of a fit."""

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
"""Minimum number of samples of a hold from which a noise level is estimated."""
BEFORE_A_STEP = 2
"""Samples at the end of a hold that are excluded from it: where samples were resampled, or read late, a
reading may lie after the step that ends the hold."""
STILL, SMALL = (0.5, 1.5), 0.005
"""Bounds for a monitored voltage to hold: on von Neumann's ratio, half the mean squared successive difference
over the variance (1 for white noise, small where it moves), and on its standard deviation, of the span."""
LEAST_PERIODS = 3
"""Minimum number of periods of a repeating input: the first still contains the transient of the start."""
LEAST_COEFFICIENTS = 8
"""Minimum number of coefficients to estimate the variance of a scale; slower scales are extrapolated."""
STEEPEST = 1.5
"""Largest slope of an extrapolated spectrum, as 1/f to this power."""
STEEPER, WANDERS = 2.0, 3
"""Factor by which the variance of 1/f noise grows from one scale to the next slower one; and the number of
steeper steps, up to the slowest scale, from which the growth counts as drift instead of noise."""
WHITE = 0.3
"""Largest correlation of a white residual with itself: three standard errors for the fewest samples, where it
exceeds this in one recording of a hundred; from 200 samples on it does not."""
LAGS, LONGEST = 100, 10
"""Largest lag of that correlation in samples, and the part of a recording, one tenth, that it is at most."""


@dataclass(frozen=True, eq=False)
class Noise:
    """The measured noise of the readings."""

    rms_um: float
    """Rms noise of one reading."""
    variance_um2: np.ndarray
    """(levels,): variance of a Haar coefficient on each scale, fastest first; its last slope goes on."""
    fs_hz: float
    """Sample rate of the recordings in which it was measured."""
    source: str
    """The kind of data from which it was measured."""
    lsb_um: float = 0.0
    """Quantisation step of the readings, if they are quantised."""
    monitor_um_per_v: float = 0.0
    """Gain with which the noise of the voltage monitor enters a prediction, if the voltage was monitored."""

    def level_um2(self, level: int) -> float:
        """Return the variance on a scale; level 1 stands for differences of neighbouring samples."""
        known = self.variance_um2
        if level <= len(known):
            return float(known[level - 1])
        last = np.log2(known[-3:])
        slope = float(np.clip(np.diff(last).mean(), 0.0, STEEPEST)) if len(last) > 1 else 0.0
        return float(known[-1] * 2 ** (slope * (level - len(known))))

    def with_converter(self, lsb_um: float) -> "Noise":
        """Return the noise with quantisation noise added, which a hold within one step may not show."""
        own = lsb_um**2 / 12
        rms_um = float(np.hypot(self.rms_um, np.sqrt(own)))
        return replace(self, rms_um=rms_um, variance_um2=self.variance_um2 + own, lsb_um=lsb_um)

    def with_monitor(self, records: Sequence[Record], um_per_v: float) -> "Noise":
        """Return the noise with that of a monitored voltage added: where the voltage moves too fast for it to
        be removed, a prediction contains it, times the gain, which no model of the stage explains."""
        left_v = [record.monitor_noise_left_v[record.train] for record in records]
        own_um = um_per_v * float(np.sqrt((np.concatenate(left_v) ** 2).mean()))
        if own_um == 0.0:
            return self
        source = f"{self.source} and in the monitored voltage"
        rms_um = float(np.hypot(self.rms_um, own_um))
        return replace(self, rms_um=rms_um, source=source, monitor_um_per_v=um_per_v)


def is_white(residual: np.ndarray) -> bool:
    """Whether the samples of a residual, (time,), do not correlate with later ones."""
    centred = residual - residual.mean()
    power = np.abs(np.fft.rfft(centred, 2 * len(centred))) ** 2
    lags = min(max(len(centred) // LONGEST, 1), LAGS)
    products = np.fft.irfft(power)
    return bool(np.abs(products[1 : lags + 1]).max() <= WHITE * products[0])


def held_error(y: np.ndarray, of: Coefficients) -> np.ndarray:
    """(cells,): mean square of the coefficients of a quantisation error, over that of white error.

    Readings that stay on one quantisation level for R samples have one error, not R independent ones. With
    the autocovariance 1 - |τ|/R of runs of R samples, a Haar coefficient on the scale of n samples has n²/6R
    times the variance of white error where n is small against R, and R times where it is large.

    Args:
        y: (time,), quantised readings.
        of: Their coefficients.
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
    """Return the measured noise with quantisation noise and that of the voltage monitor added.

    Args:
        records: The recordings.
        lsb_um: Quantisation step of the readings; 0 if they are not quantised.
        um_per_v: The gain.
        residuals: (time,) each: residuals of a simulation, used in place of the readings.
    """
    found = measured_noise(records, residuals)
    return found and found.with_converter(lsb_um).with_monitor(records, um_per_v)


def measured_noise(records: Sequence[Record], residuals: Sequence[np.ndarray] | None = None) -> Noise | None:
    """Measure the noise in holds of the command if there are any, else in its repeats, within a recording or
    between recordings; None if there are none of these.

    Args:
        records: The recordings.
        residuals: (time,) each: residuals of a simulation, used in place of the readings. They also contain
            the noise of a monitored voltage.
    """
    readings = residuals or [record.y for record in records]
    records = [replace(record, y=bridged(y, record)) for record, y in zip(records, readings, strict=True)]
    sources = (
        ("holds of the voltage", of_holds),
        ("repeated periods, the first left out", of_repeats),
        ("recordings of the same voltage", of_second_recordings),
    )
    for source, pieces in sources:
        found = [(record, list(pieces(record, records))) for record in records]
        longest = max((r.fs_hz for r, parts in found if parts), default=None)
        used = [part for record, parts in found if record.fs_hz == longest for part in parts]
        if used:
            assert longest is not None
            found_here = spectrum_of(used)
            # Slow motion has already been removed from holds.
            rms_um, variance = found_here if pieces is of_holds else without_wander(*found_here)
            if rms_um > 0:
                return Noise(rms_um, variance, longest, source)
    return None


def bridged(y: np.ndarray, record: Record) -> np.ndarray:
    """(time,): the signal, interpolated across the wrong readings of a recording, which are not noise."""
    valid = record.train | record.held_out
    k = np.arange(len(y))
    return y if valid.all() else np.interp(k, k[valid], y[valid])


def spectrum_of(pieces: Sequence[np.ndarray]) -> tuple[float, np.ndarray]:
    """Return the rms of pieces of noise, (time,) each, and (levels,) the variance of a Haar coefficient."""
    squares, counts = np.zeros(40), np.zeros(40)
    for piece in pieces:
        haar = Haar.of(piece, len(piece), np.ones(len(piece), bool), len(piece))
        full = haar.full(piece[None])[0]
        for level in range(1, haar.levels + 1):
            first, stop = haar.places(level)
            stop = first + len(piece) // 2**level  # the rest is padding
            squares[level - 1] += float((full[first:stop] ** 2).sum())
            counts[level - 1] += stop - first
    known = counts >= LEAST_COEFFICIENTS
    known[int(np.argmin(known)) :] = False
    rms_um = float(np.sqrt(sum(float(p @ p) for p in pieces) / sum(len(p) for p in pieces)))
    if not known.any():
        return rms_um, np.array([rms_um**2])
    variance = squares[known] / counts[known]
    # Quantised readings may stay constant for long, so that a variance would be zero.
    return rms_um, np.maximum(variance, 1e-4 * rms_um**2)


def without_wander(rms_um: float, variance: np.ndarray) -> tuple[float, np.ndarray]:
    """Remove from a spectrum what grows faster than 1/f towards the slowest scales, as a random walk does.

    Such growth is drift, not noise: on those scales the noise is kept at its value on the fastest of them.
    A sensor's low-pass makes noise grow in the same way, but on the fast scales.
    """
    steep = variance[1:] > STEEPER * variance[:-1]
    still = np.flatnonzero(~steep)
    first = int(still[-1]) + 1 if len(still) else len(steep)  # from this scale on it grows to the end
    if len(steep) - first < WANDERS:
        return rms_um, variance
    less = np.minimum(variance, np.where(np.arange(len(variance)) > first, variance[first], np.inf))
    share = 0.5 ** np.arange(1, len(less) + 1)
    return float(np.sqrt(less @ share + less[-1] * share[-1])), less


def of_holds(record: Record, records: Sequence[Record]) -> Iterator[np.ndarray]:
    """Yield the second half of each hold, less a cubic that removes creep, and less its spectral lines."""
    for hold in holds(record.u):
        half = record.y[(hold.start + hold.stop) // 2 : hold.stop - BEFORE_A_STEP]
        x = np.linspace(-1, 1, len(half))
        smooth = np.polynomial.polynomial.polyval(x, np.polynomial.polynomial.polyfit(x, half, 3))
        yield without_lines((half - smooth) * np.sqrt(len(half) / (len(half) - 4)))


def holds(u: np.ndarray) -> list[slice]:
    """Return where a voltage, commanded or monitored with noise, holds for `LEAST_HOLD` samples or more."""
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
    """Yield differences of neighbouring periods over root two, each less its own straight line."""
    for stretch in record.coefficients.repeats.periodic:
        if stretch.periods >= LEAST_PERIODS:
            periods = record.y[stretch.start : stretch.end].reshape(stretch.periods, stretch.period)
            for before, after in pairwise(periods[1:]):
                yield _straightened(after - before) / np.sqrt(2)


def of_second_recordings(record: Record, records: Sequence[Record]) -> Iterator[np.ndarray]:
    """Yield the second half of the difference to each later recording of the same voltage, over root two."""
    place = next(i for i, one in enumerate(records) if one is record)
    for other in records[place + 1 :]:
        same = other.fs_hz == record.fs_hz and len(other.u) == len(record.u)
        if same and np.abs(other.u - record.u).max() <= SAME * np.ptp(record.u):
            yield _straightened((other.y - record.y)[len(record.y) // 2 :]) / np.sqrt(2)


def _straightened(x: np.ndarray) -> np.ndarray:
    """Return a signal less its mean and slope."""
    t = np.linspace(-1, 1, len(x))
    straight: np.ndarray = x - x.mean() - t * (t @ x) / (t @ t)
    return straight
