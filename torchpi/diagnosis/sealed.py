"""Test an effect on the sealed end of each recording, which was used in no fit and in no choice of one.

An effect that only resembles what is missing has adapted to the samples that it was fitted to. On others it
explains less, or makes the prediction worse. Where the voltage lies outside the fitted range, the residual is
the extrapolation error of a hysteresis with many weights, whatever else is missing: such samples are ignored,
but where that voltage holds, a rate-independent hysteresis is constant, and only the mean is ignored.
"""

from collections.abc import Sequence
from math import log, sqrt

import numpy as np

from torchpi.diagnosis.hypothesis import Fit
from torchpi.diagnosis.long_recordings import means
from torchpi.diagnosis.noise import holds
from torchpi.diagnosis.records import Record

MEANS = 16
"""Number of means of the sealed samples that a slow effect is tested on."""


def confirmed(
    known: float,
    records: Sequence[Record],
    more: Fit,
    less: Sequence[Fit],
    noise_um2: float,
    own_signal: bool,
    apart: float = 0.0,
    either_way: bool = False,
    slow: bool = False,
) -> float:
    """Return the share, 0–1, that an effect explains of what is to be explained: `known` if the sealed
    samples agree, else theirs. The sealed samples are weighted by how much the effect acts there relative to
    the fitted samples: each recording by its power, all together by its rms.

    Args:
        known: The share on the fitted samples.
        records: The recordings.
        more: The fit with the effect.
        less: Fits without it: everything else refitted, and nothing but the simulation. In each recording the
            one that predicts the sealed samples best counts.
        noise_um2: Mean square that nothing explains.
        own_signal: The effect has a signal of its own: the remaining residual is ignored, and only whether
            the effect improves every recording counts.
        apart: Fraction of its gain that lies in the part that does not repeat with the voltage, 0–1.
        either_way: Take the share of the sealed samples if it is larger, too.
        slow: Compare means over a sixteenth of the sealed samples: what is faster says nothing about a slow
            effect, whatever causes it.
    """
    share, judged = known, judging_samples(records)
    for part, split in ((1.0 - apart, as_they_are), (apart, what_does_not_repeat)):
        if part == 0.0:
            continue
        gained = changed = left = ignored = here = there = 0.0
        for i, (record, e, (judging, beyond)) in enumerate(zip(records, more.residuals, judged, strict=True)):
            parts = [split(record, without_means(e, beyond), judging)]
            parts += [split(record, without_means(fit.residuals[i], beyond), judging) for fit in less]
            samples = max(len(parts[0][0]) // MEANS, 1) if slow else 1
            (e_held, e_train), *each = [
                (means(held, samples), means(train, samples)) for held, train in parts
            ]
            if not len(e_held):
                continue
            without_held, without_train = min(each, key=lambda held_and_train: mean_square(held_and_train[0]))
            after, before = mean_square(e_held) + 1e-300, mean_square(without_held) + 1e-300
            # A recording with a large error must not count more than another, so gains are ratios, and a
            # hundredfold gain in one recording is not cancelled by a twofold loss in another.
            acts, acted = mean_square(without_held - e_held), mean_square(without_train - e_train)
            votes = min(acts / max(acted, 1e-300), 1.0)
            gained += votes * log(before / after)
            changed += votes * abs(log(before / after))
            # A residual found only here is extrapolation error of the hysteresis, with or without the effect.
            usual = min(after, mean_square(e_train))
            rest = max(usual - noise_um2 / samples, 0.0)
            left += 0.0 if own_signal else votes * rest / ((after + before) / 2)
            ignored += votes * (after - usual) / ((after + before) / 2)
            here, there = here + acts, there + acted
        sealed = max(gained, 0.0) / max(changed + left, 1e-300)
        weight = min(sqrt(here / max(there, 1e-300)), 1.0)
        if sealed > known:  # by taking away a little of an extrapolation error, an effect shows nothing
            weight *= gained / (gained + ignored) if either_way else 0.0
        share += part * weight * (sealed - known)
    return share


def sealed_error_um2(records: Sequence[Record], final: Fit, noise_um2: float) -> float:
    """Return the mean square of the sealed residual above that of the fitted one and the noise."""
    judged = zip(records, final.residuals, judging_samples(records), strict=True)
    e = np.concatenate([without_means(e, beyond)[judging] for _, e, (judging, beyond) in judged])
    return max(mean_square(e) - max(final.train_rms**2, noise_um2), 0.0) if len(e) else 0.0


def judging_samples(records: Sequence[Record]) -> list[tuple[np.ndarray, list[np.ndarray]]]:
    """Return, for each recording, where its sealed samples count, (time,) of bool: within the fitted
    voltages, or while one beyond them holds; and the places of each such hold."""
    reached, found = [record.u[record.train] for record in records], []
    lowest_v, highest_v = min(u.min() for u in reached), max(u.max() for u in reached)
    for record in records:
        judging = record.held_out & (record.u >= lowest_v) & (record.u <= highest_v)
        beyond = held_at(record.u, record.held_out & ~judging)
        for places in beyond:
            judging[places] = True
        found.append((judging, beyond))
    return found


def held_at(u: np.ndarray, there: np.ndarray) -> list[np.ndarray]:
    """Return the places of each hold of a voltage, (time,), as far as they are there, (time,) of bool."""
    places = [np.arange(len(u))[hold][there[hold]] for hold in holds(u)] if there.any() else []
    return [at for at in places if len(at)]


def without_means(e: np.ndarray, places: Sequence[np.ndarray]) -> np.ndarray:
    """Return residuals, (time,), less their mean at each of these sets of places."""
    e = e.copy()
    for at in places:
        e[at] -= e[at].mean()
    return e


def as_they_are(record: Record, e: np.ndarray, judging: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the residuals of the judging samples, and those of the fitted samples."""
    return e[judging], e[record.train]


def what_does_not_repeat(record: Record, e: np.ndarray, judging: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return both without what repeats with the voltage; empty where the voltage does not repeat."""
    repeats = record.coefficients.repeats
    sealed = repeats.beyond(e)
    defined = np.isfinite(sealed) & judging[repeats.samples :]
    return sealed[defined], repeats(e[None])[0][repeats.apart]


def mean_square(e: np.ndarray) -> float:
    return float(np.mean(e**2))
