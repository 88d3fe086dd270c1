"""What the sealed end of each recording says of an effect: it was in no fit, and in no choice of one.

An effect that only resembles what is missing has bent to the samples that it was fitted to. On others it
explains less, or spoils. Where the voltage lies beyond all that was fitted, what is left is what a hysteresis
of many weights makes of voltages that it never saw, whatever else is missing: those samples do not judge.
"""

from collections.abc import Sequence
from math import log

import numpy as np

from torchpi.diagnosis.hypothesis import Fit
from torchpi.diagnosis.records import Record


def confirmed(
    known: float,
    records: Sequence[Record],
    more: Fit,
    less: Fit,
    noise_um2: float,
    alone: bool,
    apart: float = 0.0,
) -> float:
    """The share that an effect explains of what is to be explained, 0–1, if the sealed samples agree; else
    theirs. Those of each recording, and all of them, count as much as the effect acts there, beside what it
    does where it was fitted.

    Args:
        known: The share on the samples of the fit.
        records: The recordings.
        more: With the effect.
        less: Without it, everything else refitted.
        noise_um2: Mean square that nothing explains.
        alone: What else is left does not count, but only whether the effect improves every recording: it has
            a signal of its own, or cannot be extrapolated.
        apart: How much of what it gains lies in what does not repeat with the voltage, 0–1.
    """
    share, reached = known, [record.u[record.train] for record in records]
    lowest_v, highest_v = min(u.min() for u in reached), max(u.max() for u in reached)
    for part, split in ((1.0 - apart, as_they_are), (apart, what_does_not_repeat)):
        if part == 0.0:
            continue
        gained = changed = left = here = there = 0.0
        for record, e, without in zip(records, more.residuals, less.residuals, strict=True):
            judging = record.held_out & (record.u >= lowest_v) & (record.u <= highest_v)
            e_held, e_train = split(record, e, judging)
            without_held, without_train = split(record, without, judging)
            if not len(e_held):
                continue
            after, before = mean_square(e_held) + 1e-300, mean_square(without_held) + 1e-300
            # Of a recording that misses by far no more counts than of another: what is gained is a ratio, and
            # a hundredfold gain in one is not undone by a twofold loss in another.
            acts, acted = mean_square(without_held - e_held), mean_square(without_train - e_train)
            votes = min(acts / max(acted, 1e-300), 1.0)
            gained += votes * log(before / after)
            changed += votes * abs(log(before / after))
            # What is left here alone is of a hysteresis that extrapolates badly, with the effect or without.
            rest = max(min(after, mean_square(e_train)) - noise_um2, 0.0)
            left += 0.0 if alone else votes * rest / ((after + before) / 2)
            here, there = here + acts, there + acted
        sealed, weight = max(gained, 0.0) / max(changed + left, 1e-300), min(here / max(there, 1e-300), 1.0)
        share += part * weight * (min(known, sealed) - known)
    return share


def as_they_are(record: Record, e: np.ndarray, judging: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The residuals that judge, and those that were fitted."""
    return e[judging], e[record.train]


def what_does_not_repeat(record: Record, e: np.ndarray, judging: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same, less what repeats with the voltage; none where it does not repeat."""
    repeats = record.coefficients.repeats
    sealed = repeats.beyond(e)
    defined = np.isfinite(sealed) & judging[repeats.samples :]
    return sealed[defined], repeats(e[None])[0][repeats.apart]


def mean_square(e: np.ndarray) -> float:
    return float(np.mean(e**2))
