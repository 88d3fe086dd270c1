"""Intervals of the fitted parameters that hold for a coloured residual."""

import numpy as np

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.fit import jacobian, to_outer
from torchpi.diagnosis.hypothesis import Fit

BLOCKS = 30
"""Contiguous pieces of all recordings together; their scores are taken as independent."""
NINETY = 1.697
"""Two-sided 90 % quantile of Student's t with as many degrees of freedom as blocks."""


def intervals_90(chain: Chain, now: Fit) -> list[tuple[float, float]]:
    """For each slot of the fit its 90 % interval: the sandwich of White (1980) over blocks.

    cov = N⁻¹ (Σ_b s_b s_bᵀ) N⁻¹, N = Σ J Jᵀ over the fitted samples and s_b = Σ J e over those of a block.
    """
    total = sum(len(record.fitted) for record in chain.records)
    gram, scores = 0.0, []
    for i, record in enumerate(chain.records):
        _, full = jacobian(chain, now.hypothesis, now.weights, now.slots, now.theta, i)
        part, error = full[:, record.fitted], now.residuals[i][record.fitted]
        gram = gram + part @ part.T
        pieces = max(2, round(BLOCKS * len(error) / total))
        for block in np.array_split(np.arange(len(error)), pieces):
            scores.append(part[:, block] @ error[block])
    matrix = np.asarray(gram)
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    unit = matrix * scale * scale[:, None]
    unit[np.diag_indices_from(unit)] += 1e-9
    inverse = np.linalg.inv(unit)[len(now.weights) :]
    moved = np.array([inverse @ (scale * s) for s in scores]).T * scale[len(now.weights) :][:, None]
    # What the model misses where it was not fitted widens them: it is no noise, and is not in the scores.
    spread = np.sqrt((moved**2).sum(1)) * max(1.0, now.heldout_rms / now.train_rms)
    return [
        (to_outer(slot, float(t - NINETY * s)), to_outer(slot, float(t + NINETY * s)))
        for slot, t, s in zip(now.slots, now.theta, spread, strict=True)
    ]
