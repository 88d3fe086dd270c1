"""Reduction of a large hysteresis to the combinations of its rows that the recordings can distinguish."""

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from torchpi.diagnosis.chain import AT_ONCE, Chain
from torchpi.diagnosis.fit import ITERATIONS, fit, weight_prior
from torchpi.diagnosis.hypothesis import Fit, Hypothesis
from torchpi.diagnosis.hysteresis_model import HysteresisModel

FEW, MANY = 48, 300
"""Number of principal combinations for a search, and for the report. With 24, a lag may leave ten times as
much as with all, and another effect is accepted in its place; a hundred are the straight lines of plays."""
INFORMED = 0.1
"""Minimum information of the samples on a combination, relative to that of the prior, for it to be kept."""
THINNED = 3
"""One coefficient in so many is used to determine the principal combinations."""


def basis(
    chain: Chain, hypothesis: Hypothesis, weights: np.ndarray | None, kept: int
) -> tuple[Hypothesis, np.ndarray | None]:
    """Return a hypothesis, and its weights, on the principal combinations of its rows.

    Args:
        chain: The recordings.
        hypothesis: On any rows.
        weights: Weights of those rows; their combination becomes the first row. None if there are none yet.
        kept: Number of principal combinations.
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
    for i in range(len(chain.records)):
        part = whitened_rows(chain, bare, i, THINNED)[:size]
        gram += part @ part.T
    # The prior constrains a straight line less than the terms that bend it.
    prior = full.inverse_variances(weight_prior(chain), chain.gain_um_per_v)[:size]
    unit = np.sqrt(prior[-1] / prior)
    values, vectors = np.linalg.eigh(gram * THINNED * unit * unit[:, None])
    informed = int((values > INFORMED * prior[-1]).sum())
    of_plays = vectors[:, ::-1][:, : max(1, min(kept, informed))].T * unit
    # A state may add little to its plays at its initial parameters, and much at its fitted ones.
    reduction = block_diag(of_plays, np.eye(others))
    if full.reduction is not None:
        reduction = reduction @ full.reduction
    if first is None:
        return replace(hypothesis, nominal=replace(full, reduction=reduction)), None
    mixed = replace(full, reduction=np.concatenate([first[None], reduction]))
    started = np.concatenate([[1.0], np.zeros(len(reduction)), beside])
    return replace(hypothesis, nominal=mixed), started


def whitened_rows(chain: Chain, hypothesis: Hypothesis, index: int, every: int = 1) -> np.ndarray:
    """Return the whitened rows of a hysteresis for one recording, one in `every` coefficients of each scale,
    (rows, kept). They are computed in blocks, so that the rows themselves are never all in memory."""
    v, period_s, parts = chain.voltage(hypothesis, index), chain.records[index].period_s, []
    of_each_scale = np.argsort(chain.records[index].coefficients.cell, kind="stable")
    thinned = np.sort(of_each_scale[::every])
    for some in in_blocks(hypothesis.nominal):
        rows = rows_of(chain.nominal(replace(hypothesis, nominal=some), index), v, period_s)
        parts.append(chain.whitened(index, rows)[:, thinned])
    return np.concatenate(parts)


def rows_of(hysteresis: HysteresisModel, v: np.ndarray, period_s: float) -> np.ndarray:
    """(rows, time): the rows of a hysteresis for a voltage, (time,)."""
    rows = np.empty((hysteresis.kept, len(v)))
    hysteresis.fill(v, period_s, rows)
    return rows


def in_blocks(full: HysteresisModel) -> list[HysteresisModel]:
    """Split a hysteresis into models that each have some of its rows."""
    if full.reduction is None:
        return [full]
    blocks = [full.reduction[first : first + AT_ONCE] for first in range(0, full.kept, AT_ONCE)]
    return [replace(full, reduction=block) for block in blocks]


def grown(chain: Chain, hypothesis: Hypothesis, now: Fit, kept: int) -> tuple[Hypothesis, np.ndarray | None]:
    """Do the same as `basis` for a hypothesis with more rows than a fit. If the plays are the same, the fit's
    solution is the first row: a smooth density has no sharp thresholds, and would lose those of the plays."""
    larger, before = hypothesis.nominal, now.hypothesis.nominal
    if larger.pieces % before.pieces or not np.array_equal(larger.thresholds_v, before.thresholds_v):
        return basis(chain, hypothesis, None, kept)
    known = now.weights[: before.kept]
    full = known if before.reduction is None else before.reduction.T @ known
    slopes = np.tile(full[: before.of_plays], larger.pieces // before.pieces)
    weights = np.zeros(larger.size + len(chain.records) * (1 + hypothesis.history))
    weights[: len(slopes)] = slopes
    return basis(chain, replace(hypothesis, nominal=replace(larger, reduction=None)), weights, kept)


def reduced(chain: Chain, now: Fit, kept: int = FEW) -> Fit:
    """Return the same fit on few rows."""
    hypothesis, weights = basis(chain, now.hypothesis, now.weights, kept)
    assert weights is not None
    return replace(now, hypothesis=hypothesis, weights=weights)


def refitted(chain: Chain, now: Fit, iterations: int = ITERATIONS) -> Fit:
    """Return the fit repeated on many rows."""
    return fit(chain, *basis(chain, now.hypothesis, now.weights, MANY), iterations)
