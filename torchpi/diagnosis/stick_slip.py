"""Slips: a mount that sticks shows in the readings, flat while the chain before it moves, then a jump.

With a command that a converter holds, the mount may come to rest in every sample, and each slip decides where
the next one begins. Simulated freely, a chain that is right to a hundredth of a slip mistakes them all before
long: no error of a free simulation says that it is right. The readings do. They are cut where they jump; in
between the stage is stuck, and says nothing of what stands before the mount. What is left, the samples at
which it has just slipped, is fitted as any other data.

It is judged by one step: from where it rests (the mean of the readings since the last jump) it stays while
|x - y| < J, and is at x otherwise. Its rival is the chain without it, whose error is predicted from the last
readings and from how the chain moves, by an autoregression with an input (ARX; Ljung, *System
Identification*, 1999, 4.2): neither a slow misfit, nor a coloured noise, nor what is late is evidence of
slips.

Friction d while it slides cannot be told from plays of the smallest thresholds, which lose the same at a
reversal: what is found is J - d, the jump.
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
from torchpi.stage.effects.mechanics.stiction import Stiction

JUMPS = (4.0, 8.0)
"""Times the noise floor: what a reading must move by to count as a slip."""
LINES = 1.5
"""Steps of a converter that a slip must cross."""
LEAST_GAIN = 0.25
"""By how much the error of one step must fall. On development seeds of the benchmark it rises where nothing
sticks, or falls by up to 14 % behind a lag of second order, and falls by 41 to 66 % where a mount jumps by
ten times the noise."""
WORTH_A_FIT = -0.1
"""The same with few rows of the hysteresis, from which it is worth a fit with all."""
LEAST_STUCK, SLIPS_A_WEIGHT = 0.05, 5.0
"""Share of the samples that are stuck, and slips for each number of the hysteresis: fewer do not tell."""
MEMORY = 4
"""Order of the rival's autoregression, and moves of the chain that it takes."""
NEAR = np.linspace(-0.04, 0.04, 81)
"""Of the jump: how far from what parts the samples it is looked for in a free simulation."""


@dataclass(frozen=True, eq=False)
class Slips:
    """A mount that sticks, found in the readings."""

    chain: Chain
    """On the same records, with where they are stuck."""
    fit: Fit
    """The hypothesis before with stiction; its errors are those of one step."""
    least_um: float
    """What a reading moves by in a slip, at least."""
    gain: float
    """By how much the held-out error of one step falls."""


class Jump(NamedTuple):
    """J - d of a mount that sticks, µm."""

    value_um: float
    interval_90: tuple[float, float]


def slips(chain: Chain, now: Fit, floor_um: float, lsb_um: float = 0.0) -> Slips | None:
    """A mount that sticks behind this fit, if the readings show one.

    Args:
        chain: On records without rests.
        now: What is fitted so far.
        floor_um: The noise of one reading.
        lsb_um: The step of the converter: readings go from one line to the next without any slip.
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
    """The fit where readings jump by so much, and what it gains on the rival; None where too few do."""
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
    """The jump, of the last fit: nearest to what parts stuck from slipped, what slips by itself as recorded.

    Its interval, 90 %, is a jackknife over blocks, and holds both.
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
    """The same, in which a mount slips by itself."""
    return Chain([replace(record, rests=None) for record in chain.records], chain.weighting)


def with_rests(records: Sequence[Record], least_um: float) -> list[Record]:
    """The records with where they are stuck: there a chain moves nothing."""
    return [replace(record, rests=Rests(*resting(record.y, least_um))) for record in records]


def free_run(chain: Chain, last: Fit, jump_um: float) -> Fit:
    """The last fit on the records without their rests: the mount slips by itself.

    Where that does not predict every recording better than no such mount, everything is fitted without one:
    where one slip is predicted wrongly, all that follow are.
    """
    without = fit(chain, last.hypothesis.without(Stiction.name), last.weights)
    slipping = slipping_freely(chain, last, jump_um)
    better = [
        rms([record], [slips], True) < rms([record], [stays], True)
        for record, slips, stays in zip(chain.records, slipping.residuals, without.residuals, strict=True)
    ]
    return slipping if all(better) else without


def slipping_freely(chain: Chain, one: Fit, jump_um: float) -> Fit:
    """The fit on records without rests, its mount slipping by itself."""
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
    """Whether each reading stays where it was, and the mean of those since the last jump, this one apart."""
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
    """(time,), µm: from where the mount rests to where the chain before it has moved."""
    record = chain.records[index]
    assert record.rests is not None
    x = chain.output(one.hypothesis.without(Stiction.name), one.weights, index)
    far: np.ndarray = x - record.rests.at_um
    return far


def slip_threshold(records: Sequence[Record], far: Sequence[np.ndarray], but: int = -1) -> float:
    """The jump that parts the samples that are stuck from those that slipped with the fewest on the wrong
    side, µm; the block `but` of `BLOCKS` is left out."""
    size = np.concatenate([np.abs(d) for d in far])
    stuck = np.concatenate([record.rests.stuck for record in records if record.rests])
    if but >= 0:
        kept = np.arange(len(size)) * BLOCKS // len(size) != but
        size, stuck = size[kept], stuck[kept]
    order = np.argsort(size)
    wrong = np.cumsum(np.where(stuck[order], -1, 1))
    return float(size[order[np.argmin(wrong)]])


def one_step(chain: Chain, one: Fit, far: Sequence[np.ndarray], jump_um: float) -> list[np.ndarray]:
    """(time,) for each record: reading less what the last hold and the chain predict, µm."""
    errors = []
    for record, d in zip(chain.records, far, strict=True):
        assert record.rests is not None
        from_rest = record.y - record.rests.at_um
        errors.append(np.where(np.abs(d) < jump_um, from_rest, from_rest - d))
    return errors


def one_step_rival(records: Sequence[Record], residuals: Sequence[np.ndarray]) -> list[np.ndarray]:
    """What is left of residuals when each is predicted from the last ones of its recording, and from the last
    moves of the chain, µm."""
    lagged = []
    for record, e in zip(records, residuals, strict=True):
        moves = np.diff(record.y - e, prepend=record.y[0] - e[0])
        past = [np.r_[np.zeros(j), e[:-j]] for j in range(1, MEMORY + 1)]
        past += [np.r_[np.zeros(j), moves[: len(moves) - j]] for j in range(MEMORY)]
        lagged.append(np.stack(past))
    parts = [(past[:, r.train], e[r.train]) for past, r, e in zip(lagged, records, residuals, strict=True)]
    gram = sum(past @ past.T for past, _ in parts)
    right = sum(past @ e for past, e in parts)
    a = np.linalg.solve(gram + 1e-9 * np.trace(gram) * np.eye(2 * MEMORY), right)
    return [e - a @ past for past, e in zip(lagged, residuals, strict=True)]
