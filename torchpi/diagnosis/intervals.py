"""Intervals of the fitted parameters that remain valid for a coloured residual and an inexact model."""

from math import inf, sqrt

import numpy as np
from scipy.special import stdtrit

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.fit import PRIOR, prior_of
from torchpi.diagnosis.free_parameters import to_outer
from torchpi.diagnosis.hypothesis import Fit
from torchpi.diagnosis.normal_equations import to_unit_diagonal
from torchpi.diagnosis.sensitivity import jacobian

BLOCKS = 30
"""Number of contiguous blocks in all recordings together; their scores are taken as independent."""
ONE_SIDED = 0.95
"""Level of Student's t with one degree of freedom less than blocks, or recordings: 90 % two-sided."""
LINEAR = 1.0
"""Half-width of an interval in the logarithm beyond which linear steps cannot tell its width."""
TELLS = 0.1
"""Share of all information on a parameter that a jackknife fit must retain to count for its scatter."""


def intervals_90(now: Fit, covariance: np.ndarray) -> list[tuple[float, float]]:
    """Return the 90 % interval of each slot of the fit, from `covariance_90`."""
    return [
        (to_outer(slot, float(t - half)), to_outer(slot, float(t + half)))
        for slot, t, half in zip(now.slots, now.theta, np.sqrt(np.diag(covariance)), strict=True)
    ]


def covariance_90(chain: Chain, now: Fit) -> np.ndarray:
    """Return the scaled covariance of the fitted parameters, (slots, slots), by two jackknives; the roots of
    its diagonal are half the widths of their 90 % intervals.

    One jackknife leaves out a block at a time and captures the noise with its colour. The other leaves out a
    recording at a time and captures model errors, which differ from one excitation to another; for few
    recordings, Student's t accounts for how little their scatter is known. The covariances, each times its
    squared quantile, are added. Both move the fit by one Gauss–Newton step, exact for a linear model: CR3 of
    Bell and McCaffrey (2002).
    """
    if not now.slots:
        return np.zeros((0, 0))
    total = sum(record.coefficients.samples for record in chain.records)
    blocks: list[tuple[np.ndarray, np.ndarray]] = []
    recordings: list[tuple[np.ndarray, np.ndarray]] = []
    for i, record in enumerate(chain.records):
        _, (places, rows) = jacobian(chain, now.hypothesis, now.weights, now.slots, now.theta, i)
        part = np.zeros((len(now.weights) + len(now.slots), rows.shape[1]))
        part[places] = rows
        error = chain.whitened(i, now.residuals[i][None])[0]
        recordings.append((part @ part.T, part @ error))
        pieces = max(2, round(BLOCKS * record.coefficients.samples / total))
        block = record.coefficients.at * pieces // record.coefficients.samples
        for inside in (block == b for b in range(pieces)):
            blocks.append((part[:, inside] @ part[:, inside].T, part[:, inside] @ error[inside]))
    whole, n = np.sum([gram for gram, _ in recordings], 0), len(now.weights)
    # The smoothness of a density also informs its hundreds of weights, whichever part is left out.
    whole[:n, :n] += prior_of(chain, now.hypothesis, whole[:n, :n])
    scattered = [quantile(len(p)) ** 2 * scatter(whole, p, len(now.slots)) for p in (blocks, recordings)]
    return scattered[0] + scattered[1]


def distance_from_none(now: Fit, covariance: np.ndarray, name: str) -> float:
    """Return the distance of an effect's parameters from no effect, in half-widths of 90 % intervals: the
    Mahalanobis distance of the parameters that are 0 without it, over the root of their number.

    It is infinite where the covariance cannot tell: if the logarithm of a parameter is too uncertain for a
    linear step.

    Args:
        now: The fit.
        covariance: That of its slots, from `covariance_90`.
        name: The name of the effect.
    """
    far, places = list[float](), list[int]()
    for place, (slot, value) in enumerate(zip(now.slots, now.theta, strict=True)):
        if slot.member < 0 or now.hypothesis.names[slot.member] != name:
            continue
        term, half = now.hypothesis.members[slot.member], sqrt(covariance[place, place])
        if slot.log and half > LINEAR:
            return inf
        if term.effect.identity[slot.name] == 0.0 and half > 0:
            far.append((1.0 if slot.log else float(value)) / half)
            places.append(place)
    if not far:
        return inf
    halves = np.sqrt(np.diag(covariance)[places])
    correlation = covariance[np.ix_(places, places)] / np.outer(halves, halves)
    correlation[np.diag_indices_from(correlation)] += PRIOR
    return sqrt(float(np.array(far) @ np.linalg.solve(correlation, far)) / len(far))


def quantile(parts: int) -> float:
    """Return the quantile of Student's t for the scatter of so many parts."""
    return float(stdtrit(max(parts - 1, 1), ONE_SIDED))


def scatter(whole: np.ndarray, parts: list[tuple[np.ndarray, np.ndarray]], slots: int) -> np.ndarray:
    """Return the jackknife covariance of a fit's last numbers, (slots, slots), from its parts' J Jᵀ and J e.

    Where one part alone determines a parameter, the fit without that part does not count for it.
    """
    least = solved(whole, np.zeros(len(whole)), slots)[1]
    steps, count = np.zeros((len(parts), slots)), np.zeros(slots)
    for kept, (gram, score) in zip(steps, parts, strict=True):
        step, uncertainty = solved(whole - gram, score, slots)
        determined = (uncertainty > 0) & (TELLS * uncertainty < least)
        kept[determined] = step[determined]
        count += determined
    steps *= np.sqrt(np.maximum(count - 1, 0) / np.maximum(count, 1))
    return steps.T @ steps


def solved(gram: np.ndarray, score: np.ndarray, slots: int) -> tuple[np.ndarray, np.ndarray]:
    """Return, for the last numbers, the step that solves for the score, and the inverse's diagonal or 0."""
    unit, scale = to_unit_diagonal(gram, PRIOR)
    last = np.zeros((len(gram), slots))
    last[np.arange(len(gram) - slots, len(gram)), np.arange(slots)] = 1.0
    right = np.column_stack([scale * score, last])
    found = np.linalg.solve(unit, right) * scale[:, None]
    return found[-slots:, 0], np.diag(found[-slots:, 1:]) * scale[-slots:]
