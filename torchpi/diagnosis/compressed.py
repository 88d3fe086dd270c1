"""A large hysteresis mixed down to the rows that the recordings can tell apart: a search is then quick."""

from dataclasses import replace

import numpy as np

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.hypothesis import Fit

KEPT = 40
"""Rows that are kept, beside the fitted one."""


def compressed(chain: Chain, grown: Fit) -> Fit:
    """The same fit with its rows mixed down: the fitted combination first, then the principal ones."""
    if len(grown.weights) <= KEPT + 2:
        return grown
    gram = sum(
        rows @ rows.T
        for rows in (
            chain.rows(grown.hypothesis, i)[:, record.fitted] for i, record in enumerate(chain.records)
        )
    )
    size = np.diag(gram)
    scale = np.where(size > 0, 1 / np.sqrt(np.maximum(size, 1e-300)), 0.0)
    values, vectors = np.linalg.eigh(gram * scale * scale[:, None])
    kept = np.argsort(values)[::-1][:KEPT]
    mixing = np.concatenate([grown.weights[None, :-1], (vectors[:, kept] * scale[:, None]).T])
    weights = np.zeros(len(mixing) + 1)
    weights[0], weights[-1] = 1.0, grown.weights[-1]
    nominal = replace(grown.hypothesis.nominal, mixing=mixing)
    return replace(grown, hypothesis=replace(grown.hypothesis, nominal=nominal), weights=weights)
