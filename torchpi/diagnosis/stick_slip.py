"""Stick-slip: while a mount sticks, the readings stay flat although the chain before it moves, then jump.

With a command that a converter holds, the mount may come to rest in every sample, and each slip decides where
the next one begins. In a free-run simulation, even a chain that is right to a hundredth of a slip soon gets
all slips wrong, so the free-run error cannot show that it is right. The readings can. They are cut where they
jump; between jumps the stage is stuck, and its readings say nothing about what precedes the mount. The
remaining samples, at which it has just slipped, are fitted like any other data.

A sticking mount is judged by one-step-ahead prediction: from its rest (the mean of the readings since the
last jump) it stays while |x - y| < J, and is at x otherwise. The rival is the chain without the mount, whose
error is predicted from the last readings and the motion of the chain by an autoregression with an input (ARX;
Ljung, *System Identification*, 1999, 4.2), so that a slow misfit, coloured noise or lateness are not evidence
of slips.

Friction d while it slides cannot be distinguished from plays with the smallest thresholds, which lose the
same at a reversal: what is found is J - d, the jump.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numba
import numpy as np

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.fit import ROUGH, fit, rms
from torchpi.diagnosis.hypothesis import EffectTerm, Fit
from torchpi.diagnosis.intervals import BLOCKS, quantile
from torchpi.diagnosis.records import Record, Rests
from torchpi.diagnosis.reduced_basis import reduced
from torchpi.diagnosis.wrong_readings import without_outliers
from torchpi.recordings.faults import as_last_read
from torchpi.stage.effects.mechanics.stiction import Stiction

JUMPS = (4.0, 8.0)
"""Multiples of the noise floor, each tried, by which a reading must move to count as a slip."""
LINES = 1.5
"""Smallest number of converter steps that a slip must cross."""
LEAST_GAIN = 0.25
"""Smallest relative reduction of the one-step-ahead error. On development seeds of the benchmark the error
rises where nothing sticks, or falls by up to 14 % behind a lag of second order, and falls by 41 to 66 % where
a mount jumps by ten times the noise."""
WORTH_A_FIT = -0.1
"""The same with few rows of the hysteresis, from which a fit with all rows is worthwhile."""
LEAST_STUCK, SLIPS_A_WEIGHT = 0.05, 5.0
"""Least share of stuck samples, and least slips for each weight: fewer are not conclusive."""
MEMORY = 4
"""Order of the rival's autoregression, and number of moves of the chain that it takes as input."""
NEAR = np.linspace(-0.04, 0.04, 81)
"""Relative offsets from the slip threshold at which the jump is sought in a free-run simulation."""


@dataclass(frozen=True, eq=False)
class Slips:
    """A sticking mount, found in the readings."""

    chain: Chain
    """The chain on the same records, with the samples at which they are stuck."""
    fit: Fit
    """The previous hypothesis with stiction added; its errors are one-step-ahead errors."""
    least_um: float
    """Smallest move of a reading in a slip."""
    gain: float
    """Relative reduction of the one-step-ahead error on the training samples."""


class Jump(NamedTuple):
    """J - d of a mount that sticks, µm."""

    value_um: float
    interval_90: tuple[float, float]


def slips(chain: Chain, now: Fit, floor_um: float, lsb_um: float = 0.0) -> Slips | None:
    """Return the sticking mount behind this fit, if the readings show one.

    Args:
        chain: The chain on records without rests.
        now: The fit so far.
        floor_um: The noise of one reading.
        lsb_um: The step of the converter, by which readings change without any slip.
    """
    rival = rms(chain.records, one_step_rival(chain.records, now.residuals), True)
    small = reduced(chain, now)
    quick = [
        found for times in JUMPS if (found := cut(chain, small, max(times * floor_um, LINES * lsb_um), rival))
    ]
    best = max(quick, key=lambda found: found.gain, default=None)
    if best is None or best.gain < WORTH_A_FIT:
        return None
    full = cut(chain, now, best.least_um, rival)
    return full if full and full.gain > LEAST_GAIN else None


def cut(chain: Chain, now: Fit, least_um: float, rival_um: float) -> Slips | None:
    """Fit where readings jump by at least this, and compare with the rival; None if too few stick or jump."""
    resting = Chain(with_rests(chain.records, least_um), chain.weighting)
    rests = [record.rests.stuck for record in resting.records if record.rests]
    slipped = sum(int((r.train & ~r.rests.stuck).sum()) for r in resting.records if r.rests)
    if np.mean(np.concatenate(rests)) < LEAST_STUCK or slipped < SLIPS_A_WEIGHT * len(now.weights):
        return None
    one = fit(resting, now.hypothesis.plus(EffectTerm(Stiction, {})), now.weights, 3, ROUGH)
    far = [distance(resting, one, i) for i in range(len(resting.records))]
    jump_um = slip_threshold(resting.records, far)
    gain = 1.0 - rms(resting.records, one_step(resting, one, far, jump_um), True) / rival_um
    return Slips(resting, one, least_um, gain)


def jump(found: Slips, last: Fit) -> Jump:
    """Return the jump of the last fit: the one near the slip threshold whose free-run simulation fits best.

    Its 90 % interval comes from a jackknife over blocks, and contains both the jump and the threshold.
    """
    records = found.chain.records
    free = without_rests(found.chain)
    far = [distance(found.chain, last, i) for i in range(len(records))]
    threshold_um = slip_threshold(records, far)
    tried = [threshold_um * (1 + float(share)) for share in NEAR]
    value = min(tried, key=lambda jump_um: slipping_freely(free, last, jump_um).train_rms)
    without = np.array([slip_threshold(records, far, but) for but in range(BLOCKS)])
    spread = quantile(BLOCKS) * float(
        np.sqrt((BLOCKS - 1) / BLOCKS * np.sum((without - without.mean()) ** 2))
    )
    return Jump(value, (min(value, threshold_um) - spread, max(value, threshold_um) + spread))


def without_rests(chain: Chain) -> Chain:
    """Return the chain without rests, in which the mount slips by itself."""
    return Chain([replace(record, rests=None) for record in chain.records], chain.weighting)


def with_rests(records: Sequence[Record], least_um: float) -> list[Record]:
    """Return the records with the samples at which they are stuck: there a chain moves nothing."""
    return [
        replace(r, rests=Rests(*resting(as_last_read(r.y, r.train | r.held_out), least_um))) for r in records
    ]


def free_run(chain: Chain, last: Fit, jump_um: float) -> Fit:
    """Return the last fit on the records without their rests: the mount slips by itself.

    Where that does not predict every recording better than a model without such a mount, everything is fitted
    without one: after one wrongly predicted slip, all that follow are wrong.
    """
    without = fit(chain, last.hypothesis.without(Stiction.name), last.weights)
    slipping = slipping_freely(chain, last, jump_um)
    better = [
        rms([record], [slips], True) < rms([record], [stays], True)
        for record, slips, stays in zip(chain.records, slipping.residuals, without.residuals, strict=True)
    ]
    return slipping if all(better) else without


def slipping_freely(chain: Chain, one: Fit, jump_um: float) -> Fit:
    """Evaluate the fit on records without rests, with its mount slipping by itself."""
    mount = EffectTerm(Stiction, {"breakaway_um": jump_um, "rests": 1.0})
    hypothesis = one.hypothesis.without(Stiction.name).plus(mount)
    residuals = tuple(r.y - chain.output(hypothesis, one.weights, i) for i, r in enumerate(chain.records))
    return replace(
        one,
        hypothesis=hypothesis,
        residuals=residuals,
        train_rms=rms(chain.records, residuals, True),
        heldout_rms=rms(chain.records, residuals, False),
    )


@numba.njit(cache=True)
def resting(y: np.ndarray, least_um: float) -> tuple[np.ndarray, np.ndarray]:
    """Whether each reading stays where it was, and the mean of those before it since the last jump."""
    stuck, at_um = np.zeros(len(y), np.bool_), np.empty(len(y))
    mean, count = y[0], 0
    for t in range(len(y)):
        at_um[t] = mean
        stuck[t] = abs(y[t] - mean) <= least_um
        if not stuck[t]:
            mean, count = y[t], 0
        count += 1
        mean += (y[t] - mean) / count
    return stuck, at_um


def distance(chain: Chain, one: Fit, index: int) -> np.ndarray:
    """(time,), µm: distance from where the mount rests to where the chain before it has moved."""
    record = chain.records[index]
    assert record.rests is not None
    x = chain.output(one.hypothesis.without(Stiction.name), one.weights, index)
    far: np.ndarray = x - record.rests.at_um
    return far


def slip_threshold(records: Sequence[Record], far: Sequence[np.ndarray], but: int = -1) -> float:
    """Return the jump, µm, that separates stuck samples from slipped ones with the fewest on the wrong side;
    the block `but` of `BLOCKS` is left out."""
    size = np.concatenate([np.abs(d) for d in far])
    stuck = np.concatenate([record.rests.stuck for record in records if record.rests])
    if but >= 0:
        kept = np.arange(len(size)) * BLOCKS // len(size) != but
        size, stuck = size[kept], stuck[kept]
    order = np.argsort(size)
    wrong = np.cumsum(np.where(stuck[order], -1, 1))
    return float(size[order[np.argmin(wrong)]])


def one_step(chain: Chain, one: Fit, far: Sequence[np.ndarray], jump_um: float) -> list[np.ndarray]:
    """(time,) for each record: reading less its one-step-ahead prediction from last hold and chain, µm."""
    errors = []
    for record, d in zip(chain.records, far, strict=True):
        assert record.rests is not None
        from_rest = record.y - record.rests.at_um
        errors.append(np.where(np.abs(d) < jump_um, from_rest, from_rest - d))
    return errors


def one_step_rival(records: Sequence[Record], residuals: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return what remains of the residuals, µm, when each is predicted from the previous ones of its
    recording and from the latest moves of the chain."""
    lagged = []
    for record, e in zip(records, residuals, strict=True):
        moves = np.diff(record.y - e, prepend=record.y[0] - e[0])
        # A wrong reading says nothing about the next ones, whether it is known to be wrong or not yet.
        read = without_outliers(as_last_read(e, record.train | record.held_out))
        past = [np.r_[np.zeros(j), read[:-j]] for j in range(1, MEMORY + 1)]
        past += [np.r_[np.zeros(j), moves[: len(moves) - j]] for j in range(MEMORY)]
        lagged.append(np.stack(past))
    parts = [(past[:, r.train], e[r.train]) for past, r, e in zip(lagged, records, residuals, strict=True)]
    gram = sum(past @ past.T for past, _ in parts)
    right = sum(past @ e for past, e in parts)
    a = np.linalg.solve(gram + 1e-9 * np.trace(gram) * np.eye(2 * MEMORY), right)
    return [e - a @ past for past, e in zip(lagged, residuals, strict=True)]
