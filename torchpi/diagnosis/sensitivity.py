"""Sensitivity of the readings to each number of a fit: the weights, and the parameters of the effects."""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from torchpi.diagnosis.chain import AT_ONCE, Chain
from torchpi.diagnosis.free_parameters import free_parameters_of, to_inner, to_outer, value_at, with_theta
from torchpi.diagnosis.hypothesis import FreeParameter, Hypothesis
from torchpi.errors import StageError
from torchpi.stage.effects.mechanics.modal import ModalEffect
from torchpi.stage.effects.mechanics.stiction import Stiction

MOVED = 0.03
"""Change of a slot, in its logarithm or relative to its start value, from which its slope is recomputed.
The slopes of a block behind the hysteresis cost one filter and are recomputed after any change: those of a
mode change as soon as its frequency moves by a fraction of its width."""


class Sensitivity(NamedTuple):
    """Sensitivity of the whitened coefficients of one recording to the numbers of a fit."""

    places: np.ndarray
    """Indices of the numbers that affect them."""
    rows: np.ndarray
    """(places, kept)."""


class Tangent(NamedTuple):
    """Sensitivity of the whitened coefficients to the weights, at given parameters of the effects."""

    parts: list[Sensitivity]
    """One for each recording."""
    gram: np.ndarray
    """(weights, weights), J Jᵀ."""


class Slopes(NamedTuple):
    """Sensitivity of the whitened coefficients to the slots, at the values where it was last computed."""

    parts: list[Sensitivity]
    """One for each recording."""
    theta: np.ndarray
    """(slots,), the value at which the slope of each was computed."""


class Near(NamedTuple):
    """A hypothesis whose sensitivities may serve as the first ones of a fit of a similar hypothesis."""

    hypothesis: Hypothesis
    weights: np.ndarray

    def resembles(self, hypothesis: Hypothesis) -> bool:
        """Whether a hypothesis has the same weights and nearly the same sensitivity to them: an effect that
        is absent, or in another form, may have determined it."""
        mine = self.hypothesis
        return (
            {member.kind for member in mine.members} <= {member.kind for member in hypothesis.members}
            and hypothesis.nominal.structure == mine.nominal.structure
            and hypothesis.shape == mine.shape
            and (hypothesis.alignment, hypothesis.held, hypothesis.remanent, len(hypothesis.starts))
            == (mine.alignment, mine.held, mine.remanent, len(mine.starts))
            and (Stiction.name in hypothesis.names) == (Stiction.name in mine.names)
        )


def jacobian(
    chain: Chain,
    hypothesis: Hypothesis,
    weights: np.ndarray,
    slots: Sequence[FreeParameter],
    theta: np.ndarray,
    index: int,
) -> tuple[np.ndarray, Sensitivity]:
    """Return the output of one recording, (time,), and its sensitivity to each weight and slot."""
    y, first = of_weights(chain, hypothesis, weights, index)
    every = range(len(slots))
    return y, joined(first, of_slots(chain, hypothesis, weights, slots, theta, index, every))


def joined(first: Sensitivity, second: Sensitivity) -> Sensitivity:
    """Combine two sensitivities into one to the numbers of both."""
    if not len(second.places):
        return first
    return Sensitivity(*(np.concatenate(parts) for parts in zip(first, second, strict=True)))


def of_weights(
    chain: Chain, hypothesis: Hypothesis, weights: np.ndarray, index: int
) -> tuple[np.ndarray, Sensitivity]:
    """Return the output of one recording, (time,), and its sensitivity to each weight."""
    signals, rows = chain.behind_each(hypothesis, weights, index), chain.rows(hypothesis, index)
    y = chain.output_of(hypothesis, weights, index, signals)
    stuck = chain.rests(hypothesis, index)
    one = np.ones((1, len(y))) if stuck is None else np.where(stuck.stuck, 0.0, 1.0)[None]
    whitened = np.empty((len(rows) + 1, chain.records[index].coefficients.kept))
    for first in range(0, len(rows), AT_ONCE):
        some = rows[first : first + AT_ONCE]
        whitened[first : first + len(some)] = chain.whitened(
            index, chain.directions(hypothesis, some, index, signals)
        )
    whitened[-1] = chain.whitened(index, one)[0]
    used = chain.used(hypothesis, index)
    return y, Sensitivity(np.append(used, len(weights) - len(chain.records) + index), whitened)


def of_slots(
    chain: Chain,
    hypothesis: Hypothesis,
    weights: np.ndarray,
    slots: Sequence[FreeParameter],
    theta: np.ndarray,
    index: int,
    chosen: Iterable[int],
) -> Sensitivity:
    """Return the sensitivity of one recording to the chosen slots."""
    own = [j for j in chosen if slots[j].record is None or slots[j].record == index]
    rows = np.zeros((len(own), len(chain.records[index].u)))
    of_modes = chain.slopes(hypothesis, weights, index) if own else {}
    here = chain.output(hypothesis, weights, index) if own else np.zeros(0)
    for j, row in zip(own, rows, strict=True):
        s = slots[j]
        if s.member >= 0 and issubclass(hypothesis.members[s.member].effect, ModalEffect):
            if (s.member, s.name) in of_modes:  # else a coupling's number for a mode that was removed
                per_inner = to_outer(s, float(theta[j])) if s.log else s.scale
                row[:] = of_modes[s.member, s.name] * per_inner
            continue
        # Two numbers may have to be in order, such as the start and the end of a creep.
        for step in (s.step, -s.step):
            moved = np.array(theta)
            moved[j] += step
            with suppress(StageError):
                row[:] = (chain.output(with_theta(hypothesis, slots, moved), weights, index) - here) / step
                break
    return Sensitivity(len(weights) + np.array(own, dtype=int), chain.whitened(index, rows))


def of_a_filter(hypothesis: Hypothesis, slot: FreeParameter) -> bool:
    """Whether a slot is a number of a dynamic block behind the hysteresis."""
    return slot.member >= 0 and hypothesis.members[slot.member].effect.hold is not None


def slopes_of(
    chain: Chain,
    hypothesis: Hypothesis,
    weights: np.ndarray,
    slots: Sequence[FreeParameter],
    theta: np.ndarray,
    before: Slopes | None = None,
) -> Slopes:
    """Return the slope of every slot; slots that have moved little since `before` keep the old one."""
    if before is None:
        new = np.full(len(slots), True)
        at = np.array(theta)
    else:
        filters = np.array([of_a_filter(hypothesis, slot) for slot in slots], dtype=bool)
        far = abs(theta - before.theta) > np.where(filters, 0.0, MOVED)
        new = far | (filters & bool((far & filters).any()))
        at = np.where(new, theta, before.theta)
    parts = []
    for i in range(len(chain.records)):
        part = of_slots(chain, hypothesis, weights, slots, theta, i, np.flatnonzero(new).tolist())
        if before is not None:
            old = before.parts[i]
            kept = ~np.isin(old.places, part.places)
            part = joined(Sensitivity(old.places[kept], old.rows[kept]), part)
        parts.append(part)
    return Slopes(parts, at)


def sensitivities_near(
    chain: Chain, near: Near, slots: Sequence[FreeParameter], hypothesis: Hypothesis
) -> tuple[Tangent, Slopes]:
    """Return the tangent of `near`, and its slopes for the slots that a hypothesis shares with it.

    Every candidate of a round is near the same fit and adds a block that hardly changes the sensitivity of
    the output to anything else, so these sensitivities are computed once for all of them.

    Args:
        chain: The recordings.
        near: What the hypothesis resembles, with its weights.
        slots: The slots of the hypothesis.
        hypothesis: The one that is to be fitted.
    """
    mine = free_parameters_of(near.hypothesis)
    key = (identity(near), chain.weighting.token)
    if chain.linearised is None or chain.linearised[0] != key:
        values = np.array([to_inner(s, value_at(near.hypothesis, s)) for s in mine])
        tangent = tangent_of(chain, near.hypothesis, near.weights)
        chain.linearised = key, (tangent, slopes_of(chain, near.hypothesis, near.weights, mine, values))
    tangent, slopes = chain.linearised[1]
    at = {place_of(near.hypothesis, slot): j for j, slot in enumerate(mine)}
    theta, first = np.full(len(slots), np.inf), len(near.weights)
    to, scale = np.full(len(mine), -1), np.ones(len(mine))
    for k, slot in enumerate(slots):
        j = at.get(place_of(hypothesis, slot))
        if j is not None and slot.log == mine[j].log:
            to[j], scale[j] = k, 1.0 if slot.log else slot.scale / mine[j].scale
            theta[k] = to_inner(slot, value_at(near.hypothesis, mine[j]))
    parts = []
    for part in slopes.parts:
        own = part.places - first
        kept = to[own] >= 0
        rows = part.rows[kept] * scale[own[kept], None]
        parts.append(Sensitivity(first + to[own[kept]], rows))
    return tangent, Slopes(parts, theta)


def identity(near: Near) -> tuple[object, ...]:
    """Return a key that distinguishes it from others."""
    h = near.hypothesis
    members = tuple(
        (m.effect.name, m.aux, *m.shared.items(), *(tuple(own.items()) for own in m.own)) for m in h.members
    )
    nominal = (h.nominal.structure, *sorted(h.nominal.shape.items()))
    past = (h.remanent, h.starts)
    return (members, nominal, h.alignment, h.held, h.shape, past, near.weights.tobytes())


def place_of(hypothesis: Hypothesis, slot: FreeParameter) -> tuple[object, ...]:
    """Return where a slot belongs, independently of what else the hypothesis has."""
    if slot.member < 0:
        return (slot.name, slot.record)
    member = hypothesis.members[slot.member]
    return (member.effect.name, member.aux, slot.record, slot.name)


def tangent_of(chain: Chain, hypothesis: Hypothesis, weights: np.ndarray) -> Tangent:
    """Return the sensitivity of the output to the weights."""
    parts = [of_weights(chain, hypothesis, weights, i)[1] for i in range(len(chain.records))]
    return Tangent(parts, gram_of(parts, len(weights)))


def gram_of(parts: Sequence[Sensitivity], size: int) -> np.ndarray:
    """(size, size), J Jᵀ."""
    gram = np.zeros((size, size))
    for part in parts:
        gram[np.ix_(part.places, part.places)] += part.rows @ part.rows.T
    return gram
