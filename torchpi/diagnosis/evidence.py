"""How much better one fit is than another, against the residual's own colour.

Profile likelihood of Whittle: the residual's spectrum is cut into bands, eight a decade; in each the noise
has a level of its own, the one that fits. So a slow drift, or the noise of a flickering sensor, is worth as
many independent numbers as there are frequencies in its bands, not as there are samples.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

BANDS_PER_DECADE = 8
INDEPENDENT = 2 / 3
"""Share of the frequencies of a Hann-windowed spectrum that are independent (its noise bandwidth is 1.5)."""


def evidence(before: Sequence[np.ndarray], after: Sequence[np.ndarray]) -> float:
    """Gain of the log-likelihood from the residuals `before` to those `after`, µm, no penalty taken off.

    Each has one residual, (time,), for each recording.
    """
    total = 0.0
    for one, other in zip(before, after, strict=True):
        edges = bands(len(one))
        power, less = spectrum(one), spectrum(other)
        for low, high in pairwise(edges):
            ratio = (power[low:high].sum() + 1e-300) / (less[low:high].sum() + 1e-300)
            total += INDEPENDENT * (high - low) * float(np.log(ratio))
    return total


def spectrum(x: np.ndarray, padded: int | None = None) -> np.ndarray:
    """Periodogram with a Hann window, of as many samples as there are or padded with zeros to more."""
    window = np.hanning(len(x))
    return np.abs(np.fft.rfft(x * window, padded)) ** 2  # type: ignore[no-any-return]


def bands(samples: int) -> np.ndarray:
    """Edges of the bands, as indices of the spectrum, the lowest frequencies included."""
    count = samples // 2 + 1
    decades = np.log10(count)
    edges = np.unique(np.round(np.logspace(0, decades, int(BANDS_PER_DECADE * decades) + 1)).astype(int))
    return np.concatenate([[0], edges[1:]]) if edges[0] == 1 else edges
