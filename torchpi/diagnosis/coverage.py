"""What the recordings cannot show, whatever is fitted; determined before anything is decided."""

from collections.abc import Sequence

import numba
import numpy as np

from torchpi.diagnosis.lines import RESOLVED
from torchpi.diagnosis.noise import holds
from torchpi.diagnosis.records import Record
from torchpi.stage.effects.effect import DataRange, Effect
from torchpi.stage.effects.inside import InsideEffect

LEAST_STROKE = 0.1
"""Share of the travel: a smaller movement is no stroke, and levels that differ by less are one level."""
LEVELS = 2
"""Number of levels at which any voltage turns round that goes up and comes down."""
TESTED = 0.8
"""Share of the recorded voltage range that samples must span to test a prediction over all of it."""
HOLDING = 0.1
"""Share of its samples that a recording must hold, at least, to show what a loop does not."""
PACE = 1.5
"""Least ratio of the durations of slow and fast strokes for recordings to have several rates."""
HARMONICS = 10
"""Number of harmonics of a repeating command that a static curve or a loop is taken to produce."""
LEAST_PERIODS, IRREGULAR = 3, 0.01
"""Least number of periods, and their largest relative spread, for regular times of reversal."""
ELSEWHERE = 0.1
"""Share of a line's power, where the command has that line too, that it must have in another recording."""


def reason_to_leave_out(
    effect: type[Effect] | type[InsideEffect], records: Sequence[Record], seen: DataRange, starts: int
) -> str | None:
    """Why an effect is no candidate on these recordings; None if it is one.

    Args:
        effect: The effect in question.
        records: The recordings.
        seen: What the recordings span.
        starts: Number of starting points that the effect has there, within its bounds.
    """
    needs = effect.needs
    if effect.takes_aux and not seen.aux:
        return "no other signal was recorded"
    if needs.reversals and not any(turns(record) for record in records):
        return "the voltage never reverses"
    if needs.reversals > LEVELS and (found := levels(records)) < needs.reversals:
        return f"the voltage reverses at {found} levels, expected {needs.reversals}"
    if needs.pace > 1.0 and not holding(records) and (times := pace(records)) < needs.pace:
        return f"the slowest stroke takes {times:.2g} times as long as the fastest, expected {needs.pace:g}"
    if len(records) < needs.recordings:
        return f"it needs at least {needs.recordings} recordings"
    return effect.unseen if starts == 0 else None


def cannot_be_decided(records: Sequence[Record]) -> tuple[str, ...]:
    """Return a sentence for each question that these recordings leave open."""
    notes = []
    if len(records) == 1:
        notes.append(
            "There is only one recording: the effect of another load, range or day is unknown, and the "
            "held-out samples come from the same run."
        )
    if not any(turns(record) for record in records):
        notes.append(
            "The voltage never reverses: hysteresis cannot be seen, because a curved characteristic fits "
            "as well."
        )
    elif one_size(records):
        notes.append(
            "The voltage turns round at two levels only: loops of one size do not tell one kind of "
            "hysteresis from another."
        )
    still = [record.name for record in records if np.ptp(record.u) == 0]
    if still:
        notes.append(
            f"The voltage is constant in {', '.join(still)}: only noise, hum and drift can be seen there."
        )
    constant = [name for name in records[0].aux if all(np.ptp(record.aux[name]) == 0 for record in records)]
    if constant:
        notes.append(
            f"Constant in all recordings: {', '.join(constant)}; coupling from a constant signal cannot be "
            "seen."
        )
    return tuple(notes)


def untested(records: Sequence[Record], seen: DataRange) -> tuple[str, ...]:
    """Return a phrase for each way in which held-out samples are too uniform to test other predictions.

    Args:
        records: The recordings.
        seen: What the recordings span.
    """
    found = []
    held = np.concatenate([record.u[record.held_out] for record in records])
    if len(held) and np.ptp(held) < TESTED * (seen.high_v - seen.low_v):
        inside, all_of_it = f"{held.min():.3g} to {held.max():.3g}", f"{seen.low_v:.3g} to {seen.high_v:.3g}"
        found.append(f"voltages from {inside} V of the recorded {all_of_it} V")
    if any(turns(record) for record in records):
        if one_size(records):
            found.append("loops between two levels")
        if pace(records) < PACE:
            found.append("strokes at one rate")
    return tuple(found)


def one_motion(records: Sequence[Record]) -> bool:
    """Whether the voltage only goes to and fro between two levels at one rate, and never holds."""
    return not holding(records) and one_size(records) and pace(records) < PACE


def holding(records: Sequence[Record]) -> bool:
    """Whether any recording holds the voltage for a considerable part of its time."""
    held = [sum(hold.stop - hold.start for hold in holds(record.u)) for record in records]
    return any(n > HOLDING * len(record.u) for n, record in zip(held, records, strict=True))


def one_size(records: Sequence[Record]) -> bool:
    """Whether all loops of the voltage lie between the same two levels."""
    return levels(records) <= LEVELS


def turns(record: Record) -> bool:
    """Whether the voltage goes both up and down."""
    moved = np.diff(record.u)
    return bool((moved > 0).any() and (moved < 0).any())


def repeats(records: Sequence[Record]) -> list[tuple[float, float] | None]:
    """Return (period, length) of each recording, s, or None if its command does not repeat. A command repeats
    either exactly, sample by sample, or by turning round at regular times."""
    found = []
    for record in records:
        period_s = _exact_period_s(record) or _time_between_turns_s(record)
        found.append((period_s, len(record.u) * record.period_s) if period_s else None)
    return found


def _exact_period_s(record: Record) -> float | None:
    """The period of a voltage that repeats sample by sample over most of the recording; else None."""
    for stretch in record.coefficients.repeats.periodic[:1]:
        if 2 * stretch.period * stretch.periods > len(record.u):
            return stretch.period * record.period_s
    return None


def _time_between_turns_s(record: Record) -> float | None:
    """The time from one maximum of the voltage to the next, if it is always the same to within a sample.
    Periods are rarely a whole number of samples, and fewer than three do not establish a rule."""
    strokes = _strokes(record.u, LEAST_STROKE * float(np.ptp(record.u)), record.period_s)
    seconds = np.array([stroke[0] for stroke in strokes[1:]])
    periods = seconds[: len(seconds) // 2 * 2].reshape(-1, 2).sum(1)
    if len(periods) < LEAST_PERIODS or np.ptp(periods) > 2.01 * record.period_s + IRREGULAR * periods.mean():
        return None
    return float(periods.mean())


def follows_command(
    line_hz: float, power: Sequence[float], repeating: Sequence[tuple[float, float] | None]
) -> bool:
    """Whether a spectral line cannot be told from a harmonic that a curve makes of the command.

    Args:
        line_hz: Frequency of the line.
        power: Power of the line in each recording.
        repeating: (period, length), s, of each recording whose command repeats.
    """
    as_the_command = elsewhere = 0.0
    for of_line, one in zip(power, repeating, strict=True):
        if one is not None and _is_harmonic(line_hz, *one):
            as_the_command = max(as_the_command, of_line)
        else:
            elsewhere = max(elsewhere, of_line)
    return as_the_command > 0 and elsewhere < ELSEWHERE * as_the_command


def _is_harmonic(line_hz: float, period_s: float, length_s: float) -> bool:
    order = line_hz * period_s
    return order < HARMONICS + 0.5 and abs(order - round(order)) * length_s < RESOLVED * period_s


def levels(records: Sequence[Record]) -> int:
    """Number of levels at which the voltage turns round."""
    span = max(float(np.ptp(record.u)) for record in records)
    ends = sorted(end for r in records for _, _, end in _strokes(r.u, LEAST_STROKE * span, r.period_s))
    found, last = 0, -np.inf
    for end in ends:
        if end - last > LEAST_STROKE * span:
            found, last = found + 1, end
    return found


def pace(records: Sequence[Record]) -> float:
    """Ratio of the durations of the slow and the fast strokes of the voltage.

    A stroke goes from one reversal to the next, over at least a tenth of the travel. The fastest and the
    slowest twentieth of all travel do not count.
    """
    span = max(float(np.ptp(record.u)) for record in records)
    strokes = [stroke for r in records for stroke in _strokes(r.u, LEAST_STROKE * span, r.period_s)]
    if not strokes:
        return 1.0
    seconds, travel, _ = np.array(sorted(strokes)).T
    share = (np.cumsum(travel) - travel / 2) / travel.sum()
    slow, fast = np.interp(0.95, share, seconds), np.interp(0.05, share, seconds)
    return float(slow / max(fast, 1e-300))


@numba.njit(cache=True)
def _strokes(u: np.ndarray, least: float, period_s: float) -> list[tuple[float, float, float]]:
    """(seconds, travel, end) of each stroke of a voltage, (time,); reversals below `least` are noise."""
    found = []
    low = high = start = 0  # where the voltage was lowest, and highest, since the last reversal
    direction = 0
    for t in range(1, len(u)):
        if u[t] > u[high]:
            high = t
        if u[t] < u[low]:
            low = t
        if direction >= 0 and u[high] - u[t] > least:
            if direction > 0:
                found.append(((high - start) * period_s, u[high] - u[start], u[high]))
            direction, start, low = -1, high, t
        elif direction <= 0 and u[t] - u[low] > least:
            if direction < 0:
                found.append(((low - start) * period_s, u[start] - u[low], u[low]))
            direction, start, high = 1, low, t
    return found
