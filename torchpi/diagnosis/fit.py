"""Gauss–Newton over everything at once: the weights, and the parameters of every effect in the chain."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.hypothesis import Fit, Hypothesis, Member, Slot
from torchpi.diagnosis.records import Record
from torchpi.errors import StageError
from torchpi.operators.quantity import Quantity
from torchpi.stage.effects.mechanics.modal import ModalEffect

RIDGE = 1e-9
PRIOR, PRIOR_SHARE = 3e-7, 1e-2
"""Of the hysteresis's weights about 0. The first is over what the samples know of each: without it hundreds
of rows that are nearly one another, half of whose samples lie in a few holds, bend away from what was not
fitted. The second says that a weight as large as the gain of the stage costs as much as one reading that is
wrong by this share of the travel: without it powers of plays that hardly moved explode just beyond the
recorded range."""
ITERATIONS = 12
FINE, ROUGH = 1e-4, 3e-3
"""Relative gain of a step below which a fit ends: to report, and to compare."""
KEPT_PROMISE = 0.5
"""Share of the predicted decrease that a step must keep."""
LEVERAGE = 0.9
"""Of one coefficient on its own prediction, at most: one that alone determines a number predicts nothing."""
REMANENCE = 0.1
"""Of the span: the width of the prior of what the stage remembers from before a recording."""


class Sensitivity(NamedTuple):
    """How the whitened coefficients of one recording move with the numbers of a fit."""

    places: np.ndarray
    """Of the numbers that move them."""
    rows: np.ndarray
    """(places, kept)."""


def fit(
    chain: Chain,
    hypothesis: Hypothesis,
    weights: np.ndarray | None = None,
    iterations: int = ITERATIONS,
    tolerance: float = FINE,
) -> Fit:
    """The hypothesis fitted to what is not sealed, weighted, until a step gains less than the tolerance.

    Where the straight line of a step promises more than the step keeps, the weights are solved anew at the
    parameters that it leads to (variable projection: Golub and Pereyra 1973): a limit of the voltage and a
    hundred plays that have bent round a wrong one move together or not at all.
    """
    slots = slots_of(hypothesis)
    theta = np.array([to_inner(slot, value_at(hypothesis, slot)) for slot in slots])
    records = chain.records
    fresh_weights = weights is None
    if weights is None:
        weights = start_weights(chain, hypothesis)
    elif slots and any(member.effect.hold for member in hypothesis.members):
        # Weights found without a mode, or a lag, may be far from those that go with it.
        fresh = start_weights(chain, hypothesis)
        if sum_of_squares(chain, hypothesis, fresh) < sum_of_squares(chain, hypothesis, weights):
            weights = fresh
    if not slots:  # linear in the weights: done
        iterations = 0 if fresh_weights else 1
    damping = 1e-3
    n, parts = len(weights), None
    prior = np.zeros((0, 0))
    for _ in range(iterations):
        current = with_theta(hypothesis, slots, theta)
        gram, right, ss, parts = normal_equations(chain, current, weights, slots, theta)
        prior = prior if len(prior) else prior_of(chain, hypothesis, gram[:n, :n])
        ss += float(weights @ prior @ weights)
        gram, right = with_prior(gram, right, prior, weights)
        before = ss
        accepted = False
        for _ in range(6):
            step = solve(gram, right, n, damping)
            trial_theta = np.clip(
                theta + np.clip(step[n:], -1.5, 1.5),
                [to_inner(s, s.low) for s in slots],
                [to_inner(s, s.high) for s in slots],
            )
            trial, trial_weights = with_theta(hypothesis, slots, trial_theta), weights + step[:n]
            trial_ss = sum_of_squares(chain, trial, trial_weights)
            trial_ss += float(trial_weights @ prior @ trial_weights)
            promised = float(2 * step @ right - step @ gram @ step)
            if slots and promised > 1e-4 * ss and ss - trial_ss < KEPT_PROMISE * promised:
                solved, solved_ss = with_weights_solved(chain, trial, weights, prior)
                if solved_ss < trial_ss:
                    trial_weights, trial_ss = solved, solved_ss
            if trial_ss < ss:
                accepted = True
                break
            damping = max(damping * 10, 1e-3)
        if not accepted:
            break
        theta, weights, damping = trial_theta, trial_weights, damping / 10
        if trial_ss > before * (1 - tolerance):
            break
    final = with_theta(hypothesis, slots, theta)
    if parts is None:
        gram, _, _, parts = normal_equations(chain, final, weights, slots, theta)
        prior = prior_of(chain, hypothesis, gram[:n, :n])
    residuals = tuple(record.y - chain.output(final, weights, i) for i, record in enumerate(records))
    return Fit(
        final, weights, slots, theta, residuals,
        rms(records, residuals, True), rms(records, residuals, False),
        tuple(s.name for s, t in zip(slots, theta, strict=True) if at_bound(s, t)),
        left_out(chain, residuals, parts, prior),
    )  # fmt: skip


def left_out(
    chain: Chain, residuals: Sequence[np.ndarray], parts: Sequence[Sensitivity], prior: np.ndarray
) -> np.ndarray:
    """(cells,), µm²: mean square of each cell's residual, each coefficient predicted by the fit without it.

    Args:
        chain: With the recordings.
        residuals: (time,) each, µm.
        parts: The sensitivity of each recording.
        prior: (weights, weights), the inverse covariance of their prior.
    """
    root, means = whitener(parts, prior), []
    for record, residual, part in zip(chain.records, residuals, parts, strict=True):
        leverage = np.minimum((root[:, part.places] @ part.rows) ** 2, 1e6).sum(0)
        e = record.haar(residual[None])[0] / (1 - np.minimum(leverage, LEVERAGE))
        cell = record.haar.cell
        means.append(np.bincount(cell, e**2) / np.bincount(cell))
    return np.concatenate(means)


def whitener(parts: Sequence[Sensitivity], prior: np.ndarray) -> np.ndarray:
    """The inverse Cholesky factor of J Jᵀ and the prior: it makes the rows of J orthonormal."""
    size = max(int(part.places.max()) for part in parts) + 1
    gram = np.zeros((size, size))
    for part in parts:
        gram[np.ix_(part.places, part.places)] += part.rows @ part.rows.T
    gram[: len(prior), : len(prior)] += prior
    scale = 1 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    unit = gram * scale * scale[:, None]
    unit[np.diag_indices_from(unit)] += RIDGE
    return np.linalg.inv(np.linalg.cholesky(unit)) * scale  # type: ignore[no-any-return]


def with_weights_solved(
    chain: Chain, hypothesis: Hypothesis, weights: np.ndarray, prior: np.ndarray
) -> tuple[np.ndarray, float]:
    """The best weights of a hypothesis, and what they leave; infinite where the chain cannot be."""
    try:
        gram, right, _, _ = normal_equations(chain, hypothesis, weights, (), np.zeros(0))
    except StageError:
        return weights, math.inf
    gram, right = with_prior(gram, right, prior, weights)
    solved = weights + solve(gram, right, len(weights), 0.0)
    return solved, sum_of_squares(chain, hypothesis, solved) + float(solved @ prior @ solved)


def prior_of(chain: Chain, hypothesis: Hypothesis, gram: np.ndarray) -> np.ndarray:
    """(weights, weights): the inverse covariance of the weights' prior; the line, or the fitted sum, and the
    zeros have none."""
    nominal, zeros = hypothesis.nominal, len(chain.records)
    kept = nominal.kept
    prior = np.diag(PRIOR * np.diag(gram))
    each = weight_prior(chain)
    of_rows = np.eye(kept) if nominal.mixing is None else nominal.mixing @ nominal.mixing.T
    prior[:kept, :kept] += each * of_rows
    history = np.arange(kept, len(prior) - zeros)
    prior[history, history] += 1.0 / (REMANENCE * chain.span_um) ** 2
    free = [0, *range(len(prior) - zeros, len(prior))]
    prior[free] = 0.0
    prior[:, free] = 0.0
    return prior


def weight_prior(chain: Chain) -> float:
    """The inverse variance of one weight of the hysteresis, before any recording."""
    return (PRIOR_SHARE * chain.span_v / chain.weighting.typical_um) ** 2


def with_prior(
    gram: np.ndarray, right: np.ndarray, prior: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The normal equations of the fit and of the prior together."""
    gram, right, n = gram.copy(), right.copy(), len(prior)
    gram[:n, :n] += prior
    right[:n] -= prior @ weights
    return gram, right


def slots_of(hypothesis: Hypothesis) -> tuple[Slot, ...]:
    slots = []
    for name in hypothesis.shape:
        slots.append(shape_slot(hypothesis, name))
    for k, member in enumerate(hypothesis.members):
        quantities = member.effect.quantities
        for name, value in member.shared.items():
            if name in member.effect.kinds:
                continue
            slots.append(slot(k, name, None, value, quantities[name], difference(member, name)))
        for record, own in enumerate(member.own):
            for name, value in own.items():
                slots.append(slot(k, name, record, value, quantities[name], difference(member, name)))
    return tuple(slots)


SHAPE_BOUNDS = {
    "sigma_v": (1e-3, 1e3),
    "beta": (0.0, 3.0),
    "exponent": (0.5, 6.0),
    "alpha_per_v": (1e-3, 1e3),
}


def shape_slot(hypothesis: Hypothesis, name: str) -> Slot:
    low, high = SHAPE_BOUNDS[name]
    log = low > 0
    return Slot(-1, name, None, log, 0.2 if not log else 1.0, low, high)


def difference(member: Member, name: str) -> float:
    """The step of a finite difference.

    The weights learn to move what a limit has clipped already: only a step that reaches further samples tells
    whether the limit lies there.
    """
    if name in member.effect.jumps:
        return 0.04
    return 3e-3 if name in member.effect.kinks else 1e-4


def slot(member: int, name: str, record: int | None, value: float, quantity: Quantity, step: float) -> Slot:
    log = quantity.at_least >= 0
    low, high = quantity.at_least, quantity.at_most
    if log:
        low, high = max(low, abs(value) * 1e-4, 1e-300), min(high, abs(value) * 1e4)
        return Slot(member, name, record, True, 1.0, low, high, step)
    return Slot(member, name, record, False, abs(value) or 1.0, low, high, step)


def to_inner(slot: Slot, value: float) -> float:
    return math.log(value) if slot.log else value / slot.scale


def to_outer(slot: Slot, inner: float) -> float:
    value = math.exp(min(inner, 700.0)) if slot.log else inner * slot.scale
    return min(max(value, slot.low), slot.high)


def at_bound(slot: Slot, inner: float) -> bool:
    value = to_outer(slot, inner)
    span = 1e-6 * max(abs(slot.low), abs(slot.high)) if math.isfinite(slot.low + slot.high) else 0.0
    if slot.log:
        return value <= slot.low * 1.001 or value >= slot.high * 0.999
    return value <= slot.low + span or value >= slot.high - span


def value_at(hypothesis: Hypothesis, slot: Slot) -> float:
    """The present number of a slot."""
    if slot.member < 0:
        return hypothesis.nominal.shape[slot.name]
    member = hypothesis.members[slot.member]
    return (member.shared if slot.record is None else member.own[slot.record])[slot.name]


def with_theta(hypothesis: Hypothesis, slots: Sequence[Slot], theta: np.ndarray) -> Hypothesis:
    members = list(hypothesis.members)
    shape = {}
    for s, inner in zip(slots, theta, strict=True):
        value = to_outer(s, float(inner))
        if s.member < 0:
            shape[s.name] = value
            continue
        m = members[s.member]
        if s.record is None:
            members[s.member] = replace(m, shared={**m.shared, s.name: value})
        else:
            own = list(m.own)
            own[s.record] = {**own[s.record], s.name: value}
            members[s.member] = replace(m, own=tuple(own))
    nominal = hypothesis.nominal.with_shape(shape) if shape else hypothesis.nominal
    return replace(hypothesis, nominal=nominal, members=tuple(members))


def jacobian(
    chain: Chain,
    hypothesis: Hypothesis,
    weights: np.ndarray,
    slots: Sequence[Slot],
    theta: np.ndarray,
    index: int,
) -> tuple[np.ndarray, Sensitivity]:
    """Output of one recording, (time,), and its sensitivity to each weight and slot."""
    y, used, directions = chain.output_and_directions(hypothesis, weights, index)
    members, n = hypothesis.members, len(weights)
    slopes = chain.slopes(hypothesis, weights, index) if slots else {}
    stuck = chain.rests(hypothesis, index)
    one = np.ones((1, len(y))) if stuck is None else np.where(stuck.stuck, 0.0, 1.0)[None]
    own = [j for j, s in enumerate(slots) if s.record is None or s.record == index]
    rows, here = np.zeros((len(own), len(y))), chain.output(hypothesis, weights, index) if own else y
    for j, row in zip(own, rows, strict=True):
        s = slots[j]
        if s.member >= 0 and issubclass(members[s.member].effect, ModalEffect):
            if (s.member, s.name) in slopes:  # else a coupling's number for a mode that was taken away
                per_inner = to_outer(s, float(theta[j])) if s.log else s.scale
                row[:] = slopes[s.member, s.name] * per_inner
            continue
        moved = np.array(theta)
        moved[j] += s.step
        row[:] = (chain.output(with_theta(hypothesis, slots, moved), weights, index) - here) / s.step
    places = np.concatenate([used, [n - len(chain.records) + index], n + np.array(own, dtype=int)])
    whitened = [chain.whitened(index, part) for part in (directions, one, rows)]
    return y, Sensitivity(places, np.concatenate(whitened))


def normal_equations(
    chain: Chain, hypothesis: Hypothesis, weights: np.ndarray, slots: Sequence[Slot], theta: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float, list[Sensitivity]]:
    """J Jᵀ, J e and eᵀ e over the whitened coefficients, and J of each recording."""
    size = len(weights) + len(slots)
    gram, right, ss, parts = np.zeros((size, size)), np.zeros(size), 0.0, []
    for i, record in enumerate(chain.records):
        y, part = jacobian(chain, hypothesis, weights, slots, theta, i)
        error = chain.whitened(i, (record.y - y)[None])[0]
        gram[np.ix_(part.places, part.places)] += part.rows @ part.rows.T
        right[part.places] += part.rows @ error
        ss += float(error @ error)
        parts.append(part)
    return gram, right, ss, parts


def solve(gram: np.ndarray, right: np.ndarray, n: int, damping: float) -> np.ndarray:
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / scale / scale[:, None]
    scaled[np.diag_indices_from(scaled)] += RIDGE
    k = np.arange(n, len(scaled))
    scaled[k, k] += damping
    return np.linalg.solve(scaled, right / scale) / scale


def sum_of_squares(chain: Chain, hypothesis: Hypothesis, weights: np.ndarray) -> float:
    """Over the whitened coefficients; infinite where the chain cannot be."""
    ss = 0.0
    try:
        for i, record in enumerate(chain.records):
            e = chain.whitened(i, (record.y - chain.output(hypothesis, weights, i))[None])[0]
            ss += float(e @ e)
    except StageError:  # a step to a stage that cannot exist, such as limits out of order
        return math.inf
    return ss if math.isfinite(ss) else math.inf


def start_weights(chain: Chain, hypothesis: Hypothesis) -> np.ndarray:
    """Least squares on the rows as they come out of the chain, to first order in the weights."""
    nothing = np.zeros(chain.numbers(hypothesis))
    gram, right, _, _ = normal_equations(chain, hypothesis, nothing, (), np.zeros(0))
    gram, right = with_prior(gram, right, prior_of(chain, hypothesis, gram), nothing)
    return solve(gram, right, len(right), 0.0)


def rms(records: Sequence[Record], residuals: Sequence[np.ndarray], train: bool) -> float:
    """Of the training samples, or of those held out; 0 where there are none."""
    joined = np.concatenate([e[r.train == train] for r, e in zip(records, residuals, strict=True)])
    return float(np.sqrt(np.mean(joined**2))) if len(joined) else 0.0
