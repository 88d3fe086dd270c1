"""Gauss–Newton over everything at once: the weights, and the parameters of every effect in the chain."""

import math
from collections.abc import Sequence
from dataclasses import replace

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
"""Share of the decrease foretold that a step must keep."""


def fit(
    chain: Chain,
    hypothesis: Hypothesis,
    weights: np.ndarray | None = None,
    iterations: int = ITERATIONS,
    tolerance: float = FINE,
) -> Fit:
    """The hypothesis fitted to the training samples, until a step gains less than the tolerance.

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
    n, prior = len(weights), np.zeros(0)
    for _ in range(iterations):
        current = with_theta(hypothesis, slots, theta)
        gram, right, ss = normal_equations(chain, current, weights, slots, theta)
        prior = prior if len(prior) else prior_of(chain, hypothesis, gram[:n, :n])
        ss += float(prior @ weights**2)
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
            trial_ss = sum_of_squares(chain, trial, trial_weights) + float(prior @ trial_weights**2)
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
    residuals = tuple(record.y - chain.output(final, weights, i) for i, record in enumerate(records))
    return Fit(
        final, weights, slots, theta, residuals,
        rms(records, residuals, True), rms(records, residuals, False),
        tuple(s.name for s, t in zip(slots, theta, strict=True) if at_bound(s, t)),
    )  # fmt: skip


def with_weights_solved(
    chain: Chain, hypothesis: Hypothesis, weights: np.ndarray, prior: np.ndarray
) -> tuple[np.ndarray, float]:
    """The best weights of a hypothesis, and what they leave; infinite where the chain cannot be."""
    try:
        gram, right, _ = normal_equations(chain, hypothesis, weights, (), np.zeros(0))
    except StageError:
        return weights, math.inf
    gram, right = with_prior(gram, right, prior, weights)
    solved = weights + solve(gram, right, len(weights), 0.0)
    return solved, sum_of_squares(chain, hypothesis, solved) + float(prior @ solved**2)


def prior_of(chain: Chain, hypothesis: Hypothesis, gram: np.ndarray) -> np.ndarray:
    """(weights,): what each squared weight costs: the line, or the fitted sum, and the zero nothing."""
    prior = PRIOR * np.diag(gram)
    if hypothesis.nominal.mixing is None:  # combinations of rows are in no unit
        prior += (PRIOR_SHARE * chain.span_v) ** 2
    prior[[0, -1]] = 0.0
    return prior


def with_prior(
    gram: np.ndarray, right: np.ndarray, prior: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The normal equations of the fit and of the prior together."""
    gram, right, k = gram.copy(), right.copy(), np.arange(len(prior))
    gram[k, k] += prior
    right[k] -= prior * weights
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
) -> tuple[np.ndarray, np.ndarray]:
    """Output of one recording, (time,), and how its fitted samples move with each weight and slot,
    (numbers, fitted)."""
    y, directions = chain.output_and_directions(hypothesis, weights, index)
    fitted, members = chain.records[index].fitted, hypothesis.members
    slopes = chain.slopes(hypothesis, weights, index) if slots else {}
    part = np.zeros((len(directions) + len(slots), len(fitted)))
    np.take(directions, fitted, axis=1, out=part[: len(directions)])
    for j, (s, row) in enumerate(zip(slots, part[len(directions) :], strict=True)):
        if s.record is not None and s.record != index:
            continue
        if s.member >= 0 and issubclass(members[s.member].effect, ModalEffect):
            if (s.member, s.name) in slopes:  # else a coupling's number for a mode that was taken away
                per_inner = to_outer(s, float(theta[j])) if s.log else s.scale
                row[:] = slopes[s.member, s.name][fitted] * per_inner
            continue
        moved = np.array(theta)
        moved[j] += s.step
        row[:] = (chain.output(with_theta(hypothesis, slots, moved), weights, index) - y)[fitted] / s.step
    return y, part


def normal_equations(
    chain: Chain, hypothesis: Hypothesis, weights: np.ndarray, slots: Sequence[Slot], theta: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """J Jᵀ, J e and eᵀ e over the fitted samples."""
    size = len(weights) + len(slots)
    gram, right, ss = np.zeros((size, size)), np.zeros(size), 0.0
    for i, record in enumerate(chain.records):
        y, part = jacobian(chain, hypothesis, weights, slots, theta, i)
        error = (record.y - y)[record.fitted]
        gram += part @ part.T
        right += part @ error
        ss += float(error @ error)
    return gram, right, ss


def solve(gram: np.ndarray, right: np.ndarray, n: int, damping: float) -> np.ndarray:
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / scale / scale[:, None]
    scaled[np.diag_indices_from(scaled)] += RIDGE
    k = np.arange(n, len(scaled))
    scaled[k, k] += damping
    return np.linalg.solve(scaled, right / scale) / scale


def sum_of_squares(chain: Chain, hypothesis: Hypothesis, weights: np.ndarray) -> float:
    """Over the fitted samples; infinite where the chain cannot be."""
    ss = 0.0
    try:
        for i, record in enumerate(chain.records):
            e = (record.y - chain.output(hypothesis, weights, i))[record.fitted]
            ss += float(e @ e)
    except StageError:  # a step into what no stage can be, such as limits out of order
        return math.inf
    return ss if math.isfinite(ss) else math.inf


def start_weights(chain: Chain, hypothesis: Hypothesis) -> np.ndarray:
    """Least squares on the rows as they come out of the chain, to first order in the weights."""
    parts = []
    nothing = np.zeros(len(chain.rows(hypothesis, 0)) + 1)
    for i, record in enumerate(chain.records):
        y, directions = chain.output_and_directions(hypothesis, nothing, i)
        rows = directions[:, record.fitted]
        parts.append((rows @ rows.T, rows @ (record.y - y)[record.fitted]))
    gram, right = (np.sum(part, 0) for part in zip(*parts, strict=True))
    gram, right = with_prior(gram, right, prior_of(chain, hypothesis, gram), np.zeros(len(right)))
    return solve(gram, right, len(right), 0.0)


def rms(records: Sequence[Record], residuals: Sequence[np.ndarray], train: bool) -> float:
    """Of the training samples, or of those held out; 0 where there are none."""
    joined = np.concatenate([e[r.train == train] for r, e in zip(records, residuals, strict=True)])
    return float(np.sqrt(np.mean(joined**2))) if len(joined) else 0.0
