"""Count how often a record repeats one motion: a model error recurs in every repetition."""

from collections.abc import Sequence

import numpy as np
from scipy.signal import correlate

from torchpi.identification.pair import InversePair

REPEATED = 0.1  # share of the displacement's rms by which repetitions may differ
MOST_SAMPLES = 10_000  # about how many samples of a record are searched for them


def weighted_by_repetitions(pairs: Sequence[InversePair]) -> list[InversePair]:
    """Return the same records, with the slowest of several weighted as one of its repetitions.

    The paper fits S to its slow record alone, and the weights of the plays to all others (Section III). Here
    one fit uses all records, and a slow loop repeated many times would dominate it at the expense of motions
    with many turning points. A model error recurs in every repetition, so they count as one observation: with
    errors of correlation ρ → 1, n of them weigh n / (1 + (n - 1) ρ) → 1 (the design effect, Kish 1965).
    Faster records keep their weight: they resemble the motions that the inverse is for.
    """
    weighted = list(pairs)
    if len(pairs) > 1:
        slowest = int(np.argmin([pair.rate_um_s for pair in pairs]))
        pair = pairs[slowest]
        times = repetitions(pair.motion.yd[0, pair.counted].numpy())
        weighted[slowest] = pair._replace(weight=1 / times)
    return weighted


def repetitions(y: np.ndarray) -> float:
    """Return the length of a record over its period, or 1 if it does not repeat one motion to its end.

    Args:
        y: (time,), displacement.
    """
    y = y[:: max(1, len(y) // MOST_SAMPLES)]
    y = y - y.mean()
    lags = np.arange(len(y))
    squares = np.append(0.0, np.cumsum(y**2))
    both = squares[len(y) - lags] + squares[-1] - squares[lags]
    unlike = 1 - 2 * correlate(y, y, "full")[len(y) - 1 :] / np.maximum(both, np.finfo(float).tiny)
    first = int(np.argmax(unlike > 0.5))  # first lag at which the record no longer resembles itself
    like = np.flatnonzero(unlike[first : len(y) // 2 + 1] < REPEATED**2)
    if unlike[first] <= 0.5 or not len(like):
        return 1.0
    begins = first + int(like[0])
    ends = begins + int(np.argmax(np.append(unlike[begins:], np.inf) >= REPEATED**2))
    period = begins + int(np.argmin(unlike[begins:ends]))
    last = (len(y) // period - 1) * period
    return len(y) / period if unlike[last] < REPEATED**2 else 1.0
