"""The density of a Preisach operator in play form: cells of plays and pieces, with a smooth prior.

The mean slope of each play's output function, a straight line, has the same prior as a weight of plays alone,
so that a sharp dependence on the threshold stays sharp. With μ the deviation of the slopes w_ki from these
means, in units of the stage's gain over the number of plays, a density costs

    ½ `SMOOTH` [Σ (differences between neighbours)² + mean of μ²],

a Gaussian field (thin membrane: Rue and Held, *Gaussian Markov Random Fields*, 2005, 3.2.2) that means the
same on every grid. The play with r = 0 is a curve, and not a neighbour of the others. The field's principal
components on a grid are cosines, of which only the slow ones are used.
"""

from functools import cache

import numpy as np

SMOOTH = 3.0
"""Weight of the prior: a density that changes by 0.6 of the gain over the plane costs as much as one standard
deviation of noise."""
TERMS, OF_CURVE = 400, 48
"""Largest numbers of cosines of the density, and of the curve."""


def roughness(slopes: np.ndarray) -> np.ndarray:
    """Map slopes, (sums, pieces, plays), to (sums, …), whose inner products are the inverse covariance of
    the sums, up to `SMOOTH` and the gain."""
    sums, pieces, plays = slopes.shape
    slopes = slopes - slopes.mean(1, keepdims=True)
    curve, density = slopes[..., :1], (plays - 1) * slopes[..., 1:]
    parts = [
        np.sqrt(pieces) * np.diff(curve, axis=1),
        np.diff(density, axis=1),
        np.diff(density, axis=2),
        curve / np.sqrt(pieces),
        density / np.sqrt(pieces * max(plays - 1, 1)),
    ]
    return np.concatenate([part.reshape(sums, -1) for part in parts], 1)


@cache
def terms(pieces: int, plays: int) -> np.ndarray:
    """(terms, pieces × plays): a straight line for each play, then cosines of the curve and of the density
    that sum to zero over a play's pieces, each of unit roughness."""
    lines = np.zeros((plays, pieces, plays))
    lines[np.arange(plays), :, np.arange(plays)] = 1.0
    along, costs = cosines(pieces)
    along, costs = along[1:], costs[1:]
    of_curve = np.zeros((min(pieces - 1, OF_CURVE), pieces, plays))
    of_curve[:, :, 0] = (along / np.sqrt(pieces * costs + 1 / pieces)[:, None])[: len(of_curve)]
    if plays == 1:
        return np.concatenate([lines, of_curve]).reshape(1 + len(of_curve), -1)
    across, prices = cosines(plays - 1)
    both = np.add.outer(costs, prices)
    slow = np.argsort(both, axis=None, kind="stable")[:TERMS]
    k, i = np.unravel_index(slow, both.shape)
    density = np.zeros((len(slow), pieces, plays))
    density[:, :, 1:] = along[k][:, :, None] * across[i][:, None, :]
    density /= ((plays - 1) * np.sqrt(both.flat[slow] + 1 / (pieces * (plays - 1))))[:, None, None]
    all_of_them = np.concatenate([lines, of_curve, density])
    return all_of_them.reshape(len(all_of_them), -1)


def cosines(cells: int) -> tuple[np.ndarray, np.ndarray]:
    """Return orthonormal cosines, (cells, cells), the slowest first, and for each the sum of its squared
    differences from cell to cell."""
    waves = np.arange(cells)
    rows = np.sqrt(2 / cells) * np.cos(np.pi / cells * np.outer(waves, waves + 0.5))
    rows[0] = np.sqrt(1 / cells)
    return rows, 2 - 2 * np.cos(np.pi / cells * waves)
