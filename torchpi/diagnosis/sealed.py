"""What the sealed end of each recording says of an effect: it was in no fit, and in no choice of one.

An effect that only resembles what is missing has bent to the samples that it was fitted to. On others it
explains less, or spoils.
"""

from collections.abc import Sequence

import numpy as np

from torchpi.diagnosis.hypothesis import Fit
from torchpi.diagnosis.records import Record


def confirmed(
    known: float, records: Sequence[Record], more: Fit, less: Fit, noise_um2: float, of_its_own: bool
) -> float:
    """The share that an effect explains of what is to be explained, 0–1, if the sealed samples agree; else
    theirs. They count as much as the effect acts there, beside what it does where it was fitted.

    Args:
        known: The share on the samples of the fit.
        records: The recordings.
        more: With the effect.
        less: Without it, everything else refitted.
        noise_um2: Mean square that nothing explains.
        of_its_own: What else is left does not count, but only whether the effect improves every recording.
    """
    gained = changed = left = here = there = 0.0
    for record, e, without in zip(records, more.residuals, less.residuals, strict=True):
        if not record.held_out.any():
            continue
        after, before = mean_square(e[record.held_out]), mean_square(without[record.held_out])
        # Of a recording that misses by far no more counts than of another.
        scale = (after + before) / 2 + 1e-300
        gained += (before - after) / scale
        changed += abs(before - after) / scale
        left += 0.0 if of_its_own else max(after - noise_um2, 0.0) / scale
        acts = without - e
        here, there = here + mean_square(acts[record.held_out]), there + mean_square(acts[record.train])
    share, weight = max(gained, 0.0) / max(changed + left, 1e-300), min(here / max(there, 1e-300), 1.0)
    return known + weight * (min(known, share) - known)


def mean_square(e: np.ndarray) -> float:
    return float(np.mean(e**2))
