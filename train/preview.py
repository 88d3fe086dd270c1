"""How many samples a stage answers late, seen from the recordings: the look-ahead that undoes it."""

import copy
from collections.abc import Callable, Sequence

from torchpi.control.direct_inverse import DirectInverse
from torchpi.identification import InversePair
from torchpi.identification.recipe import MOST_PREVIEW
from torchpi.identification.two_stage import fit_weights

# The error has one valley over the look-ahead: so many samples of rise beyond its bottom are enough.
RISING = 3


def find_preview(
    compensator: DirectInverse,
    pairs_seen_ahead: Callable[[int], Sequence[InversePair]],
) -> int:
    """The look-ahead with which the weights (eq. 11) fit best, the polynomial being that of `compensator`.

    Args:
        compensator: Of the paper's form, fitted without look-ahead; it stays as it is.
        pairs_seen_ahead: The records to fit, for a number of samples of look-ahead.
    """
    trial = copy.deepcopy(compensator)
    best, least = 0, float("inf")
    for preview in range(MOST_PREVIEW + 1):
        rms_v, _ = fit_weights(trial, pairs_seen_ahead(preview))
        if rms_v < least:
            best, least = preview, rms_v
        elif preview == best + RISING:
            break
    return best
