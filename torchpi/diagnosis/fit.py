"""Gauss–Newton fit of everything at once: the weights, and the parameters of every effect in the chain."""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.free_parameters import (
    at_bound,
    free_parameters_of,
    to_inner,
    value_at,
    with_theta,
)
from torchpi.diagnosis.hypothesis import Fit, Hypothesis
from torchpi.diagnosis.normal_equations import solve, solve_positive, to_unit_diagonal, without_others
from torchpi.diagnosis.records import Record
from torchpi.diagnosis.sensitivity import (
    Near,
    Sensitivity,
    Slopes,
    Tangent,
    gram_of,
    joined,
    sensitivities_near,
    slopes_of,
    tangent_of,
)
from torchpi.errors import StageError

PRIOR, PRIOR_SHARE = 3e-7, 1e-2
"""Priors of the hysteresis weights about 0. The first is relative to what the samples know of each: without
it, hundreds of nearly equal rows, half of whose samples lie in a few holds, deviate from data not fitted. The
second makes a weight as large as the stage's gain cost as much as one reading that is wrong by this share of
the travel: without it, plays that hardly moved explode just beyond the recorded range."""
ITERATIONS = 12
FINE, ROUGH = 1e-4, 3e-3
"""Relative gain of a step below which a fit ends: for results to report, and for comparisons."""
KEPT_PROMISE = 0.5
"""Share of the predicted decrease that a step must achieve."""
LONGEST_STEP, MANY_TIMES = 1.5, 6.0
"""Largest steps. The first limits a number's logarithm, or a recording's own number relative to its start.
The second limits a shared number of either sign relative to its present or starting value: the readings are
nearly linear in it."""
SOLVED, MORE_THAN_LINEAR = 4, 1.1
"""Maximum number of solutions for the weights in a nonlinear chain, and the ratio of the misfit to its linear
prediction below which no further one is needed."""
WITHHELD = 0.9
"""Share of a stretch's weight that is withheld from the fit that predicts it: with all of it withheld, what
this stretch alone determines would be predicted at random."""
REMANENCE = 0.1
"""Prior width, as a share of the span, of the history that a stage remembers from before a recording."""


# A step may lead to parameters for which a state grows without bound: the error is then infinite.
@np.errstate(over="ignore", invalid="ignore")
def fit(
    chain: Chain,
    hypothesis: Hypothesis,
    weights: np.ndarray | None = None,
    iterations: int = ITERATIONS,
    tolerance: float = FINE,
    near: Near | None = None,
) -> Fit:
    """Fit the hypothesis to the unsealed samples, weighted, until a step gains less than the tolerance.

    The tangent of the weights is most of the work, and changes little with the parameters. Except in a fine
    fit, it is kept while steps achieve their predicted decrease (a chord method: Ortega and Rheinboldt 1970,
    7.1), and the slope of a slot while that slot has moved little. If a step falls short of its prediction,
    the weights are solved for anew at its parameters (variable projection: Golub and Pereyra 1973): a voltage
    limit and a hundred plays that have adapted to a wrong value of it move together or not at all.

    Args:
        chain: The recordings.
        hypothesis: The hypothesis, with the numbers from which the fit starts.
        weights: Starting weights; None solves for them first.
        iterations: Maximum number of Gauss–Newton steps.
        tolerance: Relative gain of a step below which the fit ends.
        near: Provides the first sensitivities, if it resembles the hypothesis.
    """
    slots = free_parameters_of(hypothesis)
    theta = np.array([to_inner(slot, value_at(hypothesis, slot)) for slot in slots])
    low = np.array([to_inner(s, s.low) for s in slots])
    high = np.array([to_inner(s, s.high) for s in slots])
    shared = np.array([not s.log and s.record is None for s in slots], bool)
    tangent: Tangent | None = None
    slopes: Slopes | None = None
    fresh_weights = weights is None
    if weights is not None and near is not None and near.resembles(hypothesis):
        tangent, slopes = sensitivities_near(chain, near, slots, hypothesis)
    elif weights is None:
        weights, tangent = start_weights(chain, hypothesis)
    elif slots and any(member.effect.hold for member in hypothesis.members):
        # Weights found without a mode, or a lag, may be far from those of a chain that has it.
        fresh, at_fresh = start_weights(chain, hypothesis)
        if sum_of_squares(chain, hypothesis, fresh) < sum_of_squares(chain, hypothesis, weights):
            weights, tangent = fresh, at_fresh
    if not slots:  # linear in the weights: one solution is enough
        iterations = 0 if fresh_weights else 1
    damping, current = 1e-3, with_theta(hypothesis, slots, theta)
    n, prior, last = len(weights), np.zeros((0, 0)), None
    centre = centre_of(hypothesis, n)
    about = np.concatenate([centre, np.zeros_like(theta)])
    for _ in range(iterations):
        if tangent is None:
            tangent = tangent_of(chain, current, weights)
        slopes = slopes_of(chain, current, weights, slots, theta, slopes if tolerance > FINE else None)
        prior = prior if len(prior) else np.pad(prior_of(chain, hypothesis, tangent.gram), (0, len(theta)))
        numbers = np.concatenate([weights, theta]) - about
        gram, right, ss = normal_equations(chain, current, weights, tangent, slopes)
        last = tangent, slopes
        ss += float(numbers @ prior @ numbers)
        gram, right = with_prior(gram, right, prior, numbers)
        accepted = False
        for _ in range(6):
            step = solve(gram, right, n, damping)
            reach = np.where(shared, MANY_TIMES * np.maximum(np.abs(theta), 1.0), LONGEST_STEP)
            trial_theta = np.clip(theta + np.clip(step[n:], -reach, reach), low, high)
            trial, trial_weights = with_theta(hypothesis, slots, trial_theta), weights + step[:n]
            numbers = np.concatenate([trial_weights, trial_theta]) - about
            trial_ss = sum_of_squares(chain, trial, trial_weights) + float(numbers @ prior @ numbers)
            promised = float(2 * step @ right - step @ gram @ step)
            at_trial: Tangent | None = tangent
            if slots and promised > 1e-4 * ss and ss - trial_ss < KEPT_PROMISE * promised:
                solved, solved_ss, fresh_tangent = with_weights_solved(chain, trial, weights, prior[:n, :n])
                if solved_ss < trial_ss:
                    trial_weights, trial_ss, at_trial = solved, solved_ss, fresh_tangent
            if trial_ss < ss:
                accepted = True
                break
            damping = max(damping * 10, 1e-3)
        if not accepted:
            break
        tangent = at_trial if tolerance > FINE or at_trial is not tangent or not slots else None
        theta, weights, current, damping = trial_theta, trial_weights, trial, damping / 10
        if trial_ss > ss * (1 - tolerance):
            break
    if last is None:
        tangent = tangent or tangent_of(chain, current, weights)
        last = tangent, slopes_of(chain, current, weights, slots, theta)
        prior = np.pad(prior_of(chain, hypothesis, tangent.gram), (0, len(theta)))
    parts = [joined(first, second) for first, second in zip(last[0].parts, last[1].parts, strict=True)]
    residuals = residuals_of(chain, current, weights)
    records = chain.records
    return Fit(
        current,
        weights,
        slots,
        theta,
        residuals,
        rms(records, residuals, True),
        rms(records, residuals, False),
        tuple(s for s, t in zip(slots, theta, strict=True) if at_bound(s, t)),
        left_out(chain, residuals, parts, prior),
    )


def left_out(
    chain: Chain, residuals: Sequence[np.ndarray], parts: Sequence[Sensitivity], prior: np.ndarray
) -> np.ndarray:
    """(cells,), µm²: mean square of each cell's residual when each stretch of time, with all its scales, is
    predicted by the fit to the other stretches.

    Let H be the inner products of the sensitivities plus those of the prior, J the rows of a stretch, and e
    its residual, both whitened. The predicted residual is e + c Jᵀ (H - c J Jᵀ)⁻¹ J e, with c = `WITHHELD`.

    Args:
        chain: The recordings, with their weighting.
        residuals: (time,) each, µm.
        parts: The sensitivity of each recording.
        prior: Inverse covariance of the prior: (weights, weights), or of weights and slots.
    """
    count = max(len(prior), *(int(part.places.max()) + 1 for part in parts))
    whole, of_stretches = np.zeros((count, count)), []
    whole[: len(prior), : len(prior)] = prior
    for record, part in zip(chain.records, parts, strict=True):
        stretches = [slice(first, last) for first, last in pairwise(record.coefficients.ends.tolist())]
        rows = [part.rows[:, there] for there in stretches]
        grams = [one @ one.T for one in rows]
        whole[np.ix_(part.places, part.places)] += sum(grams)
        of_stretches.append((stretches, rows, grams))
    unit, scale = to_unit_diagonal(whole)
    means = []
    for i, (record, residual, part) in enumerate(zip(chain.records, residuals, parts, strict=True)):
        e, size = chain.whitened(i, residual[None])[0], scale[part.places]
        information = without_others(unit, part.places)
        for stretch, of_it, gram in zip(*of_stretches[i], strict=True):
            others = information - WITHHELD * size * size[:, None] * gram
            moved = solve_positive(others, of_it @ e[stretch] * size) * size
            e[stretch] += WITHHELD * moved @ of_it
        e /= chain.weighting.inverse_sd[i]
        of = record.coefficients
        means.append(np.bincount(of.cell, e**2) / np.bincount(of.cell))
    return np.concatenate(means)


def whitener(parts: Sequence[Sensitivity]) -> np.ndarray:
    """The inverse Cholesky factor of J Jᵀ: it makes the rows of J orthonormal."""
    gram = gram_of(parts, max(int(part.places.max()) for part in parts) + 1)
    unit, scale = to_unit_diagonal(gram)
    whitening: np.ndarray = np.linalg.inv(np.linalg.cholesky(unit)) * scale
    return whitening


def with_weights_solved(
    chain: Chain, hypothesis: Hypothesis, weights: np.ndarray, prior: np.ndarray
) -> tuple[np.ndarray, float, Tangent | None]:
    """Solve for the best weights of a hypothesis: return them, their misfit (infinite if the chain cannot
    exist) and the tangent. In a nonlinear chain they are solved for again while the misfit exceeds what a
    linear step would leave."""
    left, tangent, centre = math.inf, None, centre_of(hypothesis, len(weights))
    for _ in range(SOLVED):
        try:
            last = tangent_of(chain, hypothesis, weights)
            gram, right, before = normal_equations(chain, hypothesis, weights, last)
        except StageError:
            break
        before += float((weights - centre) @ prior @ (weights - centre))
        gram, right = with_prior(gram, right, prior, weights - centre)
        step = solve(gram, right)
        solved = weights + step
        ss = sum_of_squares(chain, hypothesis, solved) + float((solved - centre) @ prior @ (solved - centre))
        if not ss < left:
            break
        weights, left, tangent = solved, ss, last
        if ss < MORE_THAN_LINEAR * (before - float(2 * step @ right - step @ gram @ step)):
            break
    return weights, left, tangent


def prior_of(chain: Chain, hypothesis: Hypothesis, gram: np.ndarray) -> np.ndarray:
    """(weights, weights): the inverse covariance of the weights' prior, 0 for weights that have none."""
    nominal, zeros = hypothesis.nominal, len(chain.records)
    kept = nominal.kept
    prior = np.diag(PRIOR * np.diag(gram))
    prior[:kept, :kept] += nominal.inverse_covariance(weight_prior(chain), chain.gain_um_per_v)
    history = np.arange(kept, len(prior) - zeros)
    prior[history, history] += 1.0 / (REMANENCE * chain.span_um) ** 2
    # No prior on the line (or the fitted sum in its place), the zeros, or the single Bouc–Wen state.
    free = [0, *range(len(prior) - zeros, len(prior))]
    if nominal.bouc_wen:
        free.append(kept - 1 - bool(nominal.simulation))
    prior[free] = 0.0
    prior[:, free] = 0.0
    return prior


def centre_of(hypothesis: Hypothesis, count: int) -> np.ndarray:
    """(count,): the mean of the weights' prior. A reduction begins with a fitted sum, which has no prior."""
    nominal, centre = hypothesis.nominal, np.zeros(count)
    if nominal.centre is not None and nominal.reduction is None:
        centre[: nominal.size] = nominal.centre
    return centre


def weight_prior(chain: Chain) -> float:
    """The prior inverse variance of one weight of the hysteresis."""
    return (PRIOR_SHARE * chain.span_v / chain.weighting.geometric_mean_rms_um) ** 2


def with_prior(
    gram: np.ndarray, right: np.ndarray, prior: np.ndarray, numbers: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Add the prior of the first numbers to the normal equations of the fit, given their distance from its
    mean."""
    gram, right, n = gram.copy(), right.copy(), len(prior)
    gram[:n, :n] += prior
    right[:n] -= prior @ numbers
    return gram, right


def normal_equations(
    chain: Chain,
    hypothesis: Hypothesis,
    weights: np.ndarray,
    tangent: Tangent,
    slopes: Slopes | None = None,
) -> tuple[np.ndarray, np.ndarray, float]:
    """J Jᵀ, J e and eᵀ e over the whitened coefficients."""
    n = len(weights)
    size = n + (0 if slopes is None else len(slopes.theta))
    gram, right, ss = np.zeros((size, size)), np.zeros(size), 0.0
    gram[:n, :n] = tangent.gram
    for i, residual in enumerate(residuals_of(chain, hypothesis, weights)):
        first, error = tangent.parts[i], chain.whitened(i, residual[None])[0]
        right[first.places] += first.rows @ error
        ss += float(error @ error)
        if slopes is None:
            continue
        second = slopes.parts[i]
        across = first.rows @ second.rows.T
        gram[np.ix_(first.places, second.places)] += across
        gram[np.ix_(second.places, first.places)] += across.T
        gram[np.ix_(second.places, second.places)] += second.rows @ second.rows.T
        right[second.places] += second.rows @ error
    return gram, right, ss


def residuals_of(chain: Chain, hypothesis: Hypothesis, weights: np.ndarray) -> tuple[np.ndarray, ...]:
    """The residual of each recording, (time,), µm."""
    return tuple(record.y - chain.output(hypothesis, weights, i) for i, record in enumerate(chain.records))


def sum_of_squares(chain: Chain, hypothesis: Hypothesis, weights: np.ndarray) -> float:
    """Sum of squares over the whitened coefficients; infinite if the chain cannot exist."""
    ss = 0.0
    try:
        for i, residual in enumerate(residuals_of(chain, hypothesis, weights)):
            e = chain.whitened(i, residual[None])[0]
            ss += float(e @ e)
    except StageError:  # a step to a stage that cannot exist, such as limits out of order
        return math.inf
    return ss if math.isfinite(ss) else math.inf


def start_weights(chain: Chain, hypothesis: Hypothesis) -> tuple[np.ndarray, Tangent | None]:
    """Return least-squares weights on the rows at the output of the chain, to first order in the weights, and
    the tangent, or None if it leaves out an effect that sticks, which has no slope at rest."""
    moving = hypothesis
    for member in hypothesis.members:
        if member.effect.sticks:
            moving = moving.without(member.effect.name, member.aux)
    nothing = np.zeros(chain.numbers(hypothesis))
    tangent = tangent_of(chain, moving, nothing)
    gram, right, _ = normal_equations(chain, moving, nothing, tangent)
    prior, centre = prior_of(chain, hypothesis, gram), centre_of(hypothesis, len(nothing))
    gram, right = with_prior(gram, right, prior, nothing - centre)
    return solve(gram, right), tangent if moving is hypothesis else None


def rms(records: Sequence[Record], residuals: Sequence[np.ndarray], train: bool) -> float:
    """Rms of the training samples, or of the held-out samples; 0 if there are none."""
    joined = np.concatenate(
        [e[r.train if train else r.held_out] for r, e in zip(records, residuals, strict=True)]
    )
    return float(np.sqrt(np.mean(joined**2))) if len(joined) else 0.0
