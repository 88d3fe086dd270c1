"""Where to put the thresholds when the user does not say."""

import numpy as np
from torch import Tensor

# The paper's rig: r = [0 .05 .1 .2 .3 .5 1 1.5 2 3] for S up to 10.8. A play nearly as wide as half of the
# range hardly moves after the first loading: it cannot be told from an offset. Denser near 0, where the
# loop bends most.
LARGEST = 0.3
DENSER = 2.0
MOST_SAMPLES = 1_000_000  # of which quantiles are taken


def spread_thresholds(plays: int, peak_to_peak_um: float, largest: float = LARGEST) -> list[float]:
    """r_i from 0 to `largest` times the range, their distance growing in proportion to i."""
    return [largest * peak_to_peak_um * (i / max(plays - 1, 1)) ** DENSER for i in range(plays)]


def usual_range_um(yd: Tensor) -> float:
    """From the 1 % to the 99 % quantile: a play that only the rarest peaks move is an offset to all else."""
    thinned = yd[:: max(1, len(yd) // MOST_SAMPLES)]
    low, high = np.quantile(thinned.numpy(), [0.01, 0.99])
    return float(high - low)
