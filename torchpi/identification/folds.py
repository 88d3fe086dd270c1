"""Parts of the records that each fit of a form leaves out, to be judged on them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from torchpi.identification.pair import InversePair

BLOCKS = 5  # of a single record
BLOCKS_OF_SEVERAL = 2  # of each record, besides the records themselves
MANY = 6  # records, which need no blocks
RATES = 1 / 3  # of the samples: the slowest, and the fastest


class Fold(NamedTuple):
    """Samples of each record, rising; some records may have none."""

    fitted: list[np.ndarray]
    judged: list[np.ndarray]


def make_folds(pairs: Sequence[InversePair]) -> list[Fold]:
    """Every record left out once; with fewer than `MANY` records contiguous blocks as well.

    The blocks of a single record are alike where its motion is periodic, so that they cannot tell a loop that
    is understood from one that is remembered. Its slowest and its fastest samples are left out too: they are
    motions that were not fitted.
    """
    counted = [np.arange(pair.u.shape[1])[pair.counted] for pair in pairs]
    folds = []
    if len(pairs) > 1:
        folds += [_without(counted, i, each) for i, each in enumerate(counted)]
    if len(pairs) < MANY:
        blocks = BLOCKS if len(pairs) == 1 else BLOCKS_OF_SEVERAL
        folds += [
            _without(counted, i, block)
            for i, each in enumerate(counted)
            for block in np.array_split(each, blocks)
        ]
    if len(pairs) == 1:
        speed = np.abs(pairs[0].motion.yd_dot[0].numpy()[counted[0]])
        slow, fast = np.quantile(speed, [RATES, 1 - RATES])
        folds += [_without(counted, 0, counted[0][left_out]) for left_out in (speed < slow, speed > fast)]
    return [fold for fold in folds if all(sum(map(len, part)) > 0 for part in fold)]


def _without(counted: list[np.ndarray], record: int, left_out: np.ndarray) -> Fold:
    """Fit what is not `left_out` of this record, and all of the others."""
    fitted, judged = list(counted), [each[:0] for each in counted]
    fitted[record] = np.setdiff1d(counted[record], left_out, assume_unique=True)
    judged[record] = left_out
    return Fold(fitted, judged)
