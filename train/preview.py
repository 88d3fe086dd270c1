"""Find the look-ahead that compensates the delay of a stage, in samples, from recordings."""

import copy
from collections.abc import Callable, Sequence

from torchpi.control.direct_inverse import DirectInverse
from torchpi.identification import InversePair
from torchpi.identification.recipe import MOST_PREVIEW
from torchpi.identification.two_stage import fit_weights

# The error has one minimum over the look-ahead, so the search ends after this many samples of rise.
RISING = 3


def find_preview(
    compensator: DirectInverse,
    pairs_seen_ahead: Callable[[int], Sequence[InversePair]],
) -> int:
    """Return the look-ahead with which the weights (eq. 11) fit best, with the polynomial of `compensator`.

    Args:
        compensator: Compensator of the paper's form, fitted without look-ahead; it is not modified.
        pairs_seen_ahead: Returns the records to fit for a number of samples of look-ahead.
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
