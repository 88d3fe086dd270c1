"""Cross-validation folds: parts of the records that a fit of a form leaves out and is judged on."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from torchpi.diagnosis.locate import turning_points
from torchpi.identification.pair import InversePair

BLOCKS = 5  # blocks of a single record
BLOCKS_OF_SEVERAL = 2  # of each record, in addition to leaving out whole records
MANY = 6  # from this many records on, no blocks are needed
LEAST_TURN = 0.1  # least depth of a turning point, as a share of the voltage's span
MOST_SAMPLES = 10_000  # about how many samples are searched for it
RATES = 1 / 3  # share of the samples that count as the slowest, and as the fastest


class Fold(NamedTuple):
    """Ascending sample indices of each record; some records may have none."""

    fitted: list[np.ndarray]
    judged: list[np.ndarray]


def make_folds(pairs: Sequence[InversePair]) -> list[Fold]:
    """Leave out each record once and, with fewer than `MANY` records, contiguous blocks as well.

    If the motion of a single record is periodic, its blocks are alike and cannot tell a fit that generalises
    from one that has memorised a loop. Two further folds therefore leave out its slowest and its fastest
    samples, which are motions that were not fitted. Its first loading is fitted in every fold, because the
    record contains it only once: where wide plays move only there, a fit without it cannot tell them from the
    offset, and its errors are not those of the fit to the whole record.
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
    """Make folds after the first turning point: blocks, the slowest samples and the fastest samples."""
    later = counted[counted >= _first_turn(pair.u[0].numpy(), counted)]
    speed = np.abs(pair.motion.yd_dot[0].numpy()[later])
    slow, fast = np.quantile(speed, [RATES, 1 - RATES])
    parts = [*np.array_split(later, BLOCKS), later[speed < slow], later[speed > fast]]
    return _judged([_without([counted], 0, part) for part in parts])


def _first_turn(u: np.ndarray, counted: np.ndarray) -> int:
    """Return the first counted sample at which the voltage reverses, or the first of all if it never does."""
    step = max(1, len(u) // MOST_SAMPLES)
    turns = step * turning_points(u[::step], LEAST_TURN * float(np.ptp(u)))[1:]
    return int(min(turns[(turns > counted[0]) & (turns < counted[-1])], default=counted[0]))


def _judged(folds: list[Fold]) -> list[Fold]:
    """Keep the folds that have samples both to fit and to judge."""
    return [fold for fold in folds if all(sum(map(len, part)) > 0 for part in fold)]


def _without(counted: list[np.ndarray], record: int, left_out: np.ndarray) -> Fold:
    """Return the fold that fits all samples except those `left_out` of this record, and judges these."""
    fitted, judged = list(counted), [each[:0] for each in counted]
    fitted[record] = np.setdiff1d(counted[record], left_out, assume_unique=True)
    judged[record] = left_out
    return Fold(fitted, judged)
