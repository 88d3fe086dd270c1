"""How often a record repeats one motion: an inverse that is wrong about it is wrong each time anew."""

from collections.abc import Sequence

import numpy as np
from scipy.signal import correlate

from torchpi.identification.pair import InversePair

REPEATED = 0.1  # share of the displacement's rms by which repetitions may differ
MOST_SAMPLES = 10_000  # among which they are sought


def weighted_by_repetitions(pairs: Sequence[InversePair]) -> list[InversePair]:
    """The same records; of several, the slowest with the weight of one of its repetitions.

    The paper fits S alone to its slow record, and the weights of the plays to all others (Section III). Here
    one fit takes them all, and a slow loop, over and over, would be learned by heart at the cost of motions
    of many turning points. What is wrong with the form comes back in every repetition, so that they are one
    observation: with errors of correlation ρ → 1, n of them weigh n / (1 + (n - 1) ρ) → 1 (the design effect,
    Kish 1965). Faster records keep their weight: they resemble the motions that the inverse is for.
    """
    weighted = list(pairs)
    if len(pairs) > 1:
        slowest = int(np.argmin([pair.rate_um_s for pair in pairs]))
        pair = pairs[slowest]
        times = repetitions(pair.motion.yd[0, pair.counted].numpy())
        weighted[slowest] = pair._replace(weight=1 / times)
    return weighted


def repetitions(y: np.ndarray) -> float:
    """The length of a record over its period; 1 where it does not repeat one motion to its end.

    Args:
        y: (time,), displacement.
    """
    y = y[:: max(1, len(y) // MOST_SAMPLES)]
    y = y - y.mean()
    lags = np.arange(len(y))
    squares = np.append(0.0, np.cumsum(y**2))
    both = squares[len(y) - lags] + squares[-1] - squares[lags]
    unlike = 1 - 2 * correlate(y, y, "full")[len(y) - 1 :] / np.maximum(both, np.finfo(float).tiny)
    first = int(np.argmax(unlike > 0.5))  # beyond it, the record is no longer near to itself
    like = np.flatnonzero(unlike[first : len(y) // 2 + 1] < REPEATED**2)
    if unlike[first] <= 0.5 or not len(like):
        return 1.0
    begins = first + int(like[0])
    ends = begins + int(np.argmax(np.append(unlike[begins:], np.inf) >= REPEATED**2))
    period = begins + int(np.argmin(unlike[begins:ends]))
    last = (len(y) // period - 1) * period
    return len(y) / period if unlike[last] < REPEATED**2 else 1.0
