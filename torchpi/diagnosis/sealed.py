"""What the sealed end of each recording says of an effect: it was in no fit, and in no choice of one.

An effect that only resembles what is missing has bent to the samples that it was fitted to. On others it
explains less, or spoils. Where the voltage lies beyond all that was fitted, what is left is what a hysteresis
of many weights makes of voltages that it never saw, whatever else is missing: those samples do not judge. Nor
does what it leaves in directions that the fitted samples have not determined: steps between two dozen levels
say little of a hundred plays.
"""

from collections.abc import Callable, Sequence
from math import log

import numpy as np

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.fit import RIDGE, prior_of
from torchpi.diagnosis.hypothesis import Fit
from torchpi.diagnosis.records import Record
from torchpi.diagnosis.sensitivity import at_samples, tangent_of

Determined = Callable[[int, np.ndarray, np.ndarray], np.ndarray]
"""Of which recording, which samples and their residual: the part that a fit had determined."""


def confirmed(
    known: float,
    records: Sequence[Record],
    more: Fit,
    less: Fit,
    noise_um2: float,
    alone: bool,
    apart: float = 0.0,
    determined: Determined = lambda index, judging, e: e,
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
        determined: Of sealed residuals, what judges; from `determined_by`.
    """
    share, reached = known, [record.u[record.train] for record in records]
    lowest_v, highest_v = min(u.min() for u in reached), max(u.max() for u in reached)
    for part, split in ((1.0 - apart, as_they_are), (apart, what_does_not_repeat)):
        if part == 0.0:
            continue
        gained = changed = left = here = there = 0.0
        for r, (record, e, without) in enumerate(zip(records, more.residuals, less.residuals, strict=True)):
            judging = record.held_out & (record.u >= lowest_v) & (record.u <= highest_v)
            e_held, e_train = split(record, e, judging)
            without_held, without_train = split(record, without, judging)
            if not len(e_held):
                continue
            if split is as_they_are:
                e_held, without_held = (determined(r, judging, one) for one in (e_held, without_held))
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


def determined_by(chain: Chain, fit: Fit) -> Determined:
    """What judges of sealed residuals, whose weights of the hysteresis are known as well as a fit knows them.

    With J the sensitivities of the sealed samples to the weights, over the rms σ of the residual, and P the
    weights' covariance, the residual has the covariance σ² (1 + J P Jᵀ): it is whitened by the root of that.
    """
    h, weights = fit.hypothesis, fit.weights
    known = tangent_of(chain, h, weights).gram
    known = known + prior_of(chain, h, known)

    def determined(index: int, judging: np.ndarray, e: np.ndarray) -> np.ndarray:
        rms_um = np.sqrt(mean_square(fit.residuals[index][chain.records[index].train])) + 1e-300
        places, rows = at_samples(chain, h, weights, index, judging)
        rows /= rms_um
        # The zeros of the other recordings are taken as known.
        gram = known[np.ix_(places, places)]
        scale = 1 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
        unit = gram * scale * scale[:, None]
        unit[np.diag_indices_from(unit)] += RIDGE
        rows = np.linalg.solve(np.linalg.cholesky(unit), rows * scale[:, None])
        squares, directions = np.linalg.eigh(rows @ rows.T)
        squares = np.maximum(squares, 1e-12)
        along = directions.T @ rows / np.sqrt(squares)[:, None]
        less: np.ndarray = e - ((1 - 1 / np.sqrt(1 + squares)) * (along @ e)) @ along
        return less

    return determined


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
