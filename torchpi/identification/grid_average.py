"""Average fits that differ in their thresholds, where the records do not determine which grid is right.

The direct inverse is linear in its weights, and its plays start without memory, so the loading curve

    φ(s) = Σ_i w_i max(s - r_i, 0)

determines all that they do after it. The mean of several fits with one S has the mean of their curves, and
the thresholds of all of them. Interpolated at the thresholds of one grid, it costs a controller no more than
one fit. Its slopes, the sums of the weights, are means too: it cannot run backwards where they cannot.
"""

from collections.abc import Sequence

import numpy as np
import torch

from torchpi.control.direct_inverse import DirectInverse
from torchpi.identification.monotone_problem import MonotoneProblem
from torchpi.identification.pair import InversePair

AT_REST = 0.1  # largest first displacement of a record that begins de-energised, as a share of the range


def average_over_grids(problems: Sequence[MonotoneProblem], alphas: Sequence[np.ndarray]) -> DirectInverse:
    """Write the mean of these fits into the compensator of the last problem, with its thresholds; return it.

    Args:
        problems: Problems of one form and the same records; their thresholds rise.
        alphas: α found for them, and with polynomials of lower degree, whose other coefficients are 0. The
            weights are solved for at the mean of these α.
    """
    most = len(problems[-1].alpha)
    # S' is linear in α: where S rises for all of them, it rises for their mean.
    alpha = np.mean([np.pad(one, (0, most - len(one))) for one in alphas], axis=0)
    for problem in problems:
        problem.put(alpha, problem.solve(alpha).beta)
    fits = [problem.compensator for problem in problems]
    averaged = fits[-1]
    r = averaged.plays.r.detach().numpy()
    loading = np.mean([_loading(fit, r) for fit in fits], axis=0)
    beyond = np.mean([fit.weights.theta.detach().numpy().sum(0) for fit in fits], axis=0)
    sums = np.vstack([np.diff(loading, axis=0) / np.diff(r)[:, None], beyond])
    with torch.no_grad():
        averaged.weights.theta.copy_(torch.from_numpy(np.diff(sums, axis=0, prepend=0.0)))
        averaged.offset.copy_(torch.stack([fit.offset for fit in fits]).mean(0))
    return averaged


def shows_first_loading(pair: InversePair, widest: float) -> bool:
    """Whether a record begins de-energised and wide plays do not move before its first counted sample.

    Args:
        pair: The record.
        widest: Threshold of the wide plays, as a share of the range.
    """
    y = pair.motion.yd[0]
    span = float(y[pair.counted].max() - y[pair.counted].min())
    before = y[: (pair.counted.start or 0) + 1].abs()
    return float(before[0]) <= AT_REST * span and float(before.max()) <= widest * span


def _loading(
    compensator: DirectInverse,
    s: np.ndarray,  # (positions,)
) -> np.ndarray:  # (positions, functions of the rate)
    """Return φ for each function of the rate."""
    r, theta = compensator.plays.r.detach().numpy(), compensator.weights.theta.detach().numpy()
    curve: np.ndarray = np.maximum(s[:, None] - r, 0.0) @ theta
    return curve
