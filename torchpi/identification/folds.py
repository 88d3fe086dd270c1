"""Parts of the records that each fit of a form leaves out, to be judged on them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from torchpi.diagnosis.locate import turning_points
from torchpi.identification.pair import InversePair

BLOCKS = 5  # of a single record
BLOCKS_OF_SEVERAL = 2  # of each record, besides the records themselves
MANY = 6  # records, which need no blocks
LEAST_TURN = 0.1  # share of the voltage's span: of a turning point
MOST_SAMPLES = 10_000  # among which it is sought
RATES = 1 / 3  # of the samples: the slowest, and the fastest


class Fold(NamedTuple):
    """Samples of each record, rising; some records may have none."""

    fitted: list[np.ndarray]
    judged: list[np.ndarray]


def make_folds(pairs: Sequence[InversePair]) -> list[Fold]:
    """Every record left out once; with fewer than `MANY` records contiguous blocks as well.

    The blocks of a single record are alike where its motion is periodic, so that they cannot tell a loop that
    is understood from one that is remembered. Its slowest and its fastest samples are left out too: they are
    motions that were not fitted. Its first loading is fitted in every fold, because the record holds it once:
    where wide plays have moved but there, a fit without it cannot tell them from the offset, and what it gets
    wrong is not what the fit to all of it does.
    """
    counted = [np.arange(pair.u.shape[1])[pair.counted] for pair in pairs]
    if len(pairs) == 1:
        return _of_one(pairs[0], counted[0])
    folds = []
    if len(pairs) > 1:
        folds += [_without(counted, i, each) for i, each in enumerate(counted)]
    if len(pairs) < MANY:
        folds += [
            _without(counted, i, block)
            for i, each in enumerate(counted)
            for block in np.array_split(each, BLOCKS_OF_SEVERAL)
        ]
    return _judged(folds)


def _of_one(pair: InversePair, counted: np.ndarray) -> list[Fold]:
    """Blocks, and the slowest and the fastest samples, of what comes after the first turning point."""
    later = counted[counted >= _first_turn(pair.u[0].numpy(), counted)]
    speed = np.abs(pair.motion.yd_dot[0].numpy()[later])
    slow, fast = np.quantile(speed, [RATES, 1 - RATES])
    parts = [*np.array_split(later, BLOCKS), later[speed < slow], later[speed > fast]]
    return _judged([_without([counted], 0, part) for part in parts])


def _first_turn(u: np.ndarray, counted: np.ndarray) -> int:
    """The first counted sample at which the voltage turns round; the first of all where it never does."""
    step = max(1, len(u) // MOST_SAMPLES)
    turns = step * turning_points(u[::step], LEAST_TURN * float(np.ptp(u)))[1:]
    return int(min(turns[(turns > counted[0]) & (turns < counted[-1])], default=counted[0]))


def _judged(folds: list[Fold]) -> list[Fold]:
    """Those that fit something and judge something."""
    return [fold for fold in folds if all(sum(map(len, part)) > 0 for part in fold)]


def _without(counted: list[np.ndarray], record: int, left_out: np.ndarray) -> Fold:
    """Fit what is not `left_out` of this record, and all of the others."""
    fitted, judged = list(counted), [each[:0] for each in counted]
    fitted[record] = np.setdiff1d(counted[record], left_out, assume_unique=True)
    judged[record] = left_out
    return Fold(fitted, judged)
