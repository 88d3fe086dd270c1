"""Where an input repeats, and the part of the readings that does not repeat with it.

This part is each reading less the mean of all later readings at the same phase, scaled so that white noise
stays white: Helmert's rotation (*Astronomische Nachrichten* 88, 1876) without its last row. It contains
nothing that the voltage alone causes once a transient is over, and none of a model's errors in that; drift,
hum, wrong readings and the influence of other signals remain in it, beside nothing but noise.
"""

from dataclasses import dataclass

import numba
import numpy as np

PROBES, PROBE_SAMPLES = 32, 48
LEAST_PERIOD = 32
"""Shortest period that is looked for, in samples."""
SAME = 3e-4
"""Share of the span below which two inputs that differ count as the same; a measured one has noise."""
LEAST_SWING = 0.01
"""Share of the recording's span that a period must cover, because a rest repeats as well."""
AT_MOST = 4
"""Maximum number of stretches taken from one recording."""
LEAST_AGAIN = 64
"""Minimum number of samples that come again in a stretch."""
PLAIN, STARTING, APART = KINDS = range(3)
"""Kinds of signal that are compared: the readings as they are; the part of them that does not repeat, while a
transient of the start may last; and that part afterwards."""


@dataclass(frozen=True)
class Stretch:
    """Samples start … start + periods · period, over which the input repeats exactly."""

    start: int
    period: int
    periods: int

    @property
    def end(self) -> int:
        return self.start + self.periods * self.period


def periodic_stretches(u: np.ndarray) -> tuple[Stretch, ...]:
    """Return where the input repeats exactly, twice or more, longest stretch first; none overlaps another.

    Short probes of the input are searched for further on in the record; each distance at which one recurs is
    tried as a period over the whole record. Of distances that fit the same stretch, the shortest is taken.
    Periods that are not a whole number of samples are found at their first whole multiple.
    """
    span = float(np.ptp(u))
    if span == 0 or len(u) < 2 * LEAST_PERIOD:
        return ()
    found: list[Stretch] = []
    free = np.ones(len(u), dtype=bool)
    lags = _lags(u, SAME * span)
    while len(found) < AT_MOST:
        options = [stretch for lag in lags if (stretch := _stretch(u, free, int(lag), span))]
        if not options:
            break
        longest = max(one.period * one.periods for one in options)
        best = min(
            (one for one in options if one.period * one.periods > 0.9 * longest), key=lambda one: one.period
        )
        found.append(best)
        free[best.start : best.start + best.period * best.periods] = False
    return tuple(found)


def _lags(u: np.ndarray, tolerance: float) -> np.ndarray:
    """Return the distances at which a moving piece of the input recurs."""
    lags: set[int] = set()
    for start in np.linspace(0, len(u) - PROBE_SAMPLES - 1, PROBES).astype(int):
        probe = u[start : start + PROBE_SAMPLES]
        if np.ptp(probe) <= 10 * tolerance:
            continue
        at = start + LEAST_PERIOD + np.arange(max(len(u) - PROBE_SAMPLES - start - LEAST_PERIOD, 0))
        for j in (0, PROBE_SAMPLES - 1, *range(1, PROBE_SAMPLES - 1)):
            at = at[np.abs(u[at + j] - probe[j]) <= tolerance]
        lags.update(int(lag) for lag in at[:8] - start)
    return np.array(sorted(lags), dtype=int)


def _stretch(u: np.ndarray, free: np.ndarray, lag: int, span: float) -> Stretch | None:
    """Return the longest stretch of whole periods of this length, ending where the input stops repeating."""
    same = (np.abs(u[lag:] - u[:-lag]) <= SAME * span) & free[lag:] & free[:-lag]
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]])))
    starts, stops = edges[::2], edges[1::2]
    if not len(starts) or (stops - starts).max() < lag:
        return None
    longest = int((stops - starts).argmax())
    periods = (int(stops[longest]) + lag - int(starts[longest])) // lag
    start = int(stops[longest]) + lag - periods * lag
    swing = float(np.ptp(u[start : start + lag]))
    return Stretch(start, lag, periods) if swing > LEAST_SWING * span else None


@dataclass(frozen=True, eq=False)
class Repeats:
    """The part of a recording's readings that does not repeat, on each stretch over which its input does."""

    periodic: tuple[Stretch, ...]
    """The stretches of the whole recording."""
    samples: int
    """Number of samples that are used, from the first."""
    stretches: np.ndarray  # shape: (stretches, 3), int: first sample, one past the last, and the period
    go_on: np.ndarray  # shape: (stretches,), int: the end of each, which may lie beyond the samples used
    valid: np.ndarray  # shape: (samples,), bool: readings that count
    apart: np.ndarray  # shape: (samples,), bool: readings that count and come again

    @classmethod
    def of(cls, u: np.ndarray, samples: int, valid: np.ndarray) -> "Repeats":
        """Return those of a recording from its voltage, (time,), and which of its readings count, (time,)."""
        periodic = periodic_stretches(u)
        found = [
            (one.start, min(one.end, samples), one.period, one.end)
            for one in sorted(periodic, key=lambda one: one.start)
            # A whole period has to come again, or enough of one for a spectrum.
            if min(one.end, samples) - one.start >= one.period + LEAST_AGAIN
        ]
        table = np.array(found, dtype=int).reshape(-1, 4)
        stretches, mask = np.ascontiguousarray(table[:, :3]), np.ascontiguousarray(valid[:samples])
        apart = np.zeros(samples, dtype=bool)
        _less_later(np.zeros((1, samples)), mask, stretches, apart, np.empty((1, samples)))
        return cls(periodic, samples, stretches, table[:, 3], mask, apart)

    @property
    def pieces(self) -> list[tuple[int, int, int]]:
        """(first sample, one past the last, kind) of each piece. The first period of a stretch contains the
        transient of the start; if there are at most two periods, the first half of the first one does."""
        found = []
        for start, stop, period in self.stretches.tolist():
            last = stop - period
            settled = min(start + (period if stop - start > 2 * period else period // 2), last)
            found += [(start, settled, STARTING), (settled, last, APART)]
        return [one for one in found if one[1] > one[0]]

    def beyond(self, e: np.ndarray) -> np.ndarray:
        """Return the non-repeating part of a signal, (time,), after the samples used, (those after,): NaN
        where the input does not go on repeating."""
        found = np.full(len(e) - self.samples, np.nan)
        for (start, stop, period), end in zip(self.stretches.tolist(), self.go_on.tolist(), strict=True):
            phase, valid = (np.arange(start, end) - start) % period, self.valid[start:stop]
            number, (mean,) = _means_of_phases(e[None, start:stop], phase[: stop - start], valid, period)
            later = phase[stop - start :]
            n = np.where(number > 0, number, np.nan)[later]
            found[: end - stop] = np.sqrt(n / (n + 1)) * (e[stop:end] - mean[later])
        return found

    def less_mean(self, rows: np.ndarray, counts: np.ndarray) -> np.ndarray:
        """Return rows, (rows, time), less their mean at each phase over the samples that count, (time,) of
        bool; 0 where fewer than two do."""
        found = np.zeros(rows.shape)
        for one in self.periodic:
            phase, there = np.arange(one.end - one.start) % one.period, counts[one.start : one.end]
            within = rows[:, one.start : one.end]
            number, mean = _means_of_phases(within, phase, there, one.period)
            found[:, one.start : one.end] = np.where(number[phase] > 1, within - mean[:, phase], 0.0)
        return found

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """Return the non-repeating part, (rows, samples), of rows, (rows, time): 0 where nothing recurs."""
        out = np.zeros((len(rows), self.samples))
        _less_later(rows, self.valid, self.stretches, np.empty(self.samples, dtype=np.bool_), out)
        return out


def _means_of_phases(
    rows: np.ndarray, phase: np.ndarray, counts: np.ndarray, period: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the number of samples that count, (time,) of bool, at each phase, (period,), and the means of
    rows, (rows, time), over them, (rows, period)."""
    number = np.bincount(phase[counts], minlength=period)
    sums = np.stack([np.bincount(phase[counts], row[counts], period) for row in rows])
    return number, sums / np.maximum(number, 1)


@numba.njit(cache=True)
def _less_later(
    rows: np.ndarray, valid: np.ndarray, stretches: np.ndarray, apart: np.ndarray, out: np.ndarray
) -> None:
    for k in range(len(stretches)):
        start, stop, period = stretches[k]
        share = 1.0 / np.arange(1, (stop - start) // period + 3)
        root = np.sqrt(1.0 - share)
        total, number = np.empty(period), np.empty(period, np.int64)
        for i in range(len(rows)):
            total[:], number[:] = 0.0, 0
            for last in range(stop, start, -period):
                for phase in range(min(period, last - start)):
                    t = last - 1 - phase
                    if not valid[t]:
                        continue
                    x, n = rows[i, t], number[phase]
                    if n > 0:
                        apart[t] = True
                        out[i, t] = root[n] * (x - total[phase] * share[n - 1])
                    total[phase] += x
                    number[phase] = n + 1
