"""A large hysteresis on the combinations of its rows that the recordings can tell apart."""

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.fit import ITERATIONS, fit, prior_of_one
from torchpi.diagnosis.hypothesis import Fit, Hypothesis

FEW, MANY = 48, 200
"""Principal combinations for a search, and to report. With 24 a lag may leave ten times as much as with all
of them, and something else is accepted in its place."""
INFORMED = 0.1
"""What the samples know of a combination, over what the prior does, from which it is kept."""
THINNED = 3
"""One coefficient in so many tells the principal combinations."""


def basis(
    chain: Chain, hypothesis: Hypothesis, weights: np.ndarray | None, kept: int
) -> tuple[Hypothesis, np.ndarray | None]:
    """A hypothesis, and its weights, on the principal combinations of its rows.

    Args:
        chain: The recordings.
        hypothesis: On whatever rows.
        weights: Of those; their combination becomes the first row. None where there are none yet.
        kept: Principal combinations.
    """
    nominal = hypothesis.nominal
    full = nominal.unreduced
    others = full.size - full.of_plays
    size = full.kept - others
    bare, gram = replace(hypothesis, nominal=full), np.zeros((size, size))
    first, beside = weights, np.zeros(0)
    if weights is not None:
        first, beside = np.split(weights, [nominal.kept])
        first = first if nominal.reduction is None else nominal.reduction.T @ first
    if full.reduction is None and size <= kept + 1:
        return bare, None if first is None else np.concatenate([first, beside])
    for i, record in enumerate(chain.records):
        rows = np.empty((full.kept, len(record.u)))
        chain.nominal(bare, i).fill(chain.voltage(bare, i), record.period_s, rows)
        part = np.ascontiguousarray(chain.whitened(i, rows[:size])[:, ::THINNED])
        gram += part @ part.T
    values, vectors = np.linalg.eigh(gram * THINNED)
    informed = int((values > INFORMED * prior_of_one(chain, full)).sum())
    of_plays = vectors[:, ::-1][:, : max(1, min(kept, informed))].T
    # What a state adds to its plays may be little where it begins, and much where its numbers lead.
    reduction = block_diag(of_plays, np.eye(others))
    if full.reduction is not None:
        reduction = reduction @ full.reduction
    if first is None:
        return replace(hypothesis, nominal=replace(full, reduction=reduction)), None
    mixed = replace(full, reduction=np.concatenate([first[None], reduction]))
    started = np.concatenate([[1.0], np.zeros(len(reduction)), beside])
    return replace(hypothesis, nominal=mixed), started


def reduced(chain: Chain, now: Fit, kept: int = FEW) -> Fit:
    """The same fit on few rows."""
    hypothesis, weights = basis(chain, now.hypothesis, now.weights, kept)
    assert weights is not None
    return replace(now, hypothesis=hypothesis, weights=weights)


def refitted(chain: Chain, now: Fit, iterations: int = ITERATIONS) -> Fit:
    """The fit on many rows."""
    return fit(chain, *basis(chain, now.hypothesis, now.weights, MANY), iterations)
