"""Cross-validation over recordings: how well each recording is predicted by the others.

A hysteresis model with hundreds of weights may fit every recording, including its sealed end, down to the
noise and still be wrong about the next motion: steps say little about the minor loops of a decaying sine.
Predicting each recording from the others reveals this (Stone, *J. Royal Statistical Society B* 36(2), 1974).
"""

from collections.abc import Sequence
from math import sqrt

import numpy as np

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.diagnosis import AcrossRecordings
from torchpi.diagnosis.fit import centre_of, prior_of, start_weights, with_weights_solved
from torchpi.diagnosis.hypothesis import Fit, Hypothesis
from torchpi.diagnosis.normal_equations import solve
from torchpi.diagnosis.records import Record
from torchpi.diagnosis.reduced_basis import MANY, basis
from torchpi.diagnosis.sealed import mean_square
from torchpi.diagnosis.sensitivity import tangent_of

REACHED = 0.9
"""Share of a recording's voltage span that the other recordings must cover."""


def across_recordings(chain: Chain, final: Fit) -> tuple[AcrossRecordings, ...]:
    """Predict each recording whose voltages the others cover from a fit to the others.

    The parameters of the effects are few and are not refitted: that a mode is excited in only one recording
    is no reason to doubt it. The hysteresis weights are fitted to the other recordings; only history and zero
    are fitted to the recording itself.

    Args:
        chain: The recordings, with the weighting of the final fit.
        final: The fit under test.
    """
    reached = [reached_by_others(chain.records, i) for i in range(len(chain.records))]
    if not any(reached):
        return ()
    hypothesis, _ = basis(chain, final.hypothesis, None, MANY)
    start, tangent = start_weights(chain, hypothesis)
    tangent = tangent or tangent_of(chain, hypothesis, start)
    prior = prior_of(chain, hypothesis, tangent.gram)
    weights, _, found = with_weights_solved(chain, hypothesis, start, prior)
    tangent = found or tangent
    right, own_right = -prior @ (weights - centre_of(hypothesis, len(weights))), []
    for i, part in enumerate(tangent.parts):
        error = chain.whitened(i, (chain.records[i].y - chain.output(hypothesis, weights, i))[None])[0]
        own_right.append(part.rows @ error)
        right[part.places] += own_right[i]
    across = []
    for i, (record, part) in enumerate(zip(chain.records, tangent.parts, strict=True)):
        if not reached[i]:
            continue
        gram, less = tangent.gram + prior, right.copy()
        gram[np.ix_(part.places, part.places)] -= part.rows @ part.rows.T
        less[part.places] -= own_right[i]
        shared = np.setdiff1d(np.arange(len(weights)), part.places[part.places >= hypothesis.nominal.kept])
        of_others = weights.copy()
        of_others[shared] += solve(gram[np.ix_(shared, shared)], less[shared])
        counts = record.train | record.held_out
        left = beside_its_own(chain, hypothesis, of_others, i)[counts]
        fitted = final.residuals[i][counts]
        across.append(AcrossRecordings(record.name, *(sqrt(mean_square(e)) for e in (left, fitted))))
    return tuple(across)


def reached_by_others(records: Sequence[Record], index: int) -> bool:
    """Whether the other recordings cover the voltages of one: beyond their range they cannot predict it."""
    u, others = records[index].u, [record.u for k, record in enumerate(records) if k != index]
    if not others:
        return False
    low_v, high_v = min(one.min() for one in others), max(one.max() for one in others)
    return bool(min(high_v, u.max()) - max(low_v, u.min()) >= REACHED * np.ptp(u) > 0)


def beside_its_own(chain: Chain, hypothesis: Hypothesis, weights: np.ndarray, index: int) -> np.ndarray:
    """(time,), µm: residual of a recording after its own history and zero have been fitted to it."""
    record = chain.records[index]
    signals = chain.behind_each(hypothesis, weights, index)
    left = record.y - chain.output_of(hypothesis, weights, index, signals)
    past = chain.rows(hypothesis, index)[hypothesis.nominal.kept :]
    rows = np.concatenate([chain.directions(hypothesis, past, index, signals), np.ones((1, len(left)))])
    counts = record.train | record.held_out
    own = np.linalg.lstsq(rows[:, counts].T, left[counts], rcond=None)[0]
    remaining: np.ndarray = left - own @ rows
    return remaining
