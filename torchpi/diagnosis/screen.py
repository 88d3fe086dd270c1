"""Screen: estimate how much of the residual each candidate could explain, before any refit.

The direction of a candidate is what it adds to the output at its start values. Projected off the tangent of
the present hypothesis, so that what refitting would absorb does not count, it bounds how much better the
residual could be predicted. Each start costs one pass of the chain.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.fit import whitener
from torchpi.diagnosis.hypothesis import EffectTerm, Fit
from torchpi.diagnosis.normal_equations import solve
from torchpi.diagnosis.records import Record
from torchpi.diagnosis.sensitivity import jacobian
from torchpi.stage.effects.effect import Effect, Parameters
from torchpi.stage.effects.inside import InsideEffect
from torchpi.stage.effects.mechanics.modal import ModalEffect

RESIZED = (0.02, 3.0)
"""Smallest and largest factor by which a start is resized: to first order, no more is known."""
ROUNDING = 1e-7
"""Fraction of a squared direction: a smaller part off the tangent is rounding error."""


@dataclass(frozen=True)
class Candidate:
    """A start of an effect, with its estimated gain."""

    member: EffectTerm
    """The effect with the size that explains most, to first order."""
    gain: float
    """Nats that it could gain, to first order."""
    at_once: float
    """Nats that it gains with its numbers as they are, to first order in all others."""


class Screen:
    """The present fit, prepared for projecting candidates off its tangent."""

    def __init__(self, chain: Chain, now: Fit) -> None:
        self.chain, self.now, self.records = chain, now, chain.records
        parts, self.bases = [], []
        for i in range(len(self.records)):
            y, part = jacobian(self.chain, now.hypothesis, now.weights, now.slots, now.theta, i)
            self.bases.append(y)
            parts.append(part)
        root = whitener(parts)
        self.tangent = np.concatenate([root[:, part.places] @ part.rows for part in parts], axis=1)
        """(numbers, coefficients), orthonormal."""
        self.residual = np.concatenate([chain.whitened(i, e[None])[0] for i, e in enumerate(now.residuals)])
        each = [record.coefficients for record in self.records]
        first = np.cumsum([0, *(of.cells for of in each)])
        self.cell = np.concatenate([of.cell + k for of, k in zip(each, first, strict=False)])
        self.variance_um2 = 1 / np.concatenate(chain.weighting.inverse_sd) ** 2
        self.left = self.off_tangent(self.residual[None])[0]
        self.before = chain.weighting.of_squares(self.squares(self.left))

    def squares(self, whitened: np.ndarray) -> np.ndarray:
        """(cells,): mean squares, µm², of a whitened residual, (coefficients,)."""
        sums: np.ndarray = np.bincount(self.cell, whitened**2 * self.variance_um2)
        means: np.ndarray = sums / self.chain.weighting.counts
        return means

    def candidates(self, members: Sequence[EffectTerm]) -> list[Candidate]:
        """Return candidates with their gains, 0 where one does not change the output."""
        directions = [self.directions(member) for member in members]
        left = self.off_tangent(np.concatenate(directions))
        parts = np.split(left, np.cumsum([len(each) for each in directions])[:-1])
        return [self.candidate(member, part) for member, part in zip(members, parts, strict=True)]

    def candidate(self, member: EffectTerm, off_tangent: np.ndarray) -> Candidate:
        """Return the candidate for a start with these directions, (directions, coefficients)."""
        first, factor = off_tangent[0], 1.0
        gain = self.gain(off_tangent, not (signed(member) or member.effect.hold))
        if member.own and signed(member):
            # The output is linear in them. From smaller values, others diverge before these have grown.
            member = self.with_solved(member, off_tangent)
        elif (sizes := sizes_of(member)) and first.any():
            factor = float(np.clip((first @ self.left) / (first @ first), *RESIZED))
            member = self.resized(member, sizes, factor)
        return Candidate(member, gain, gain if signed(member) else self.gained(self.left - factor * first))

    def resized(self, member: EffectTerm, sizes: Sequence[str], factor: float) -> EffectTerm:
        """Scale the numbers that set the size of a member by a factor, within their bounds."""
        bounds = member.effect.quantities
        return replace(
            member,
            shared={
                name: bounds[name].nearest(value * factor) if name in sizes else value
                for name, value in member.shared.items()
            },
        )

    def with_solved(self, member: EffectTerm, off_tangent: np.ndarray) -> EffectTerm:
        """Give each signed number of a member, with directions (directions, coefficients), the value that
        explains most, to first order in all of them."""
        alive, factors = np.linalg.norm(off_tangent, axis=1) > 0.0, np.zeros(len(off_tangent))
        factors[alive] = self.coefficients(off_tangent[alive])
        return scaled(member, dict(zip(signed_numbers(member), factors.tolist(), strict=True)))

    def off_tangent(self, directions: np.ndarray) -> np.ndarray:
        """Return directions, (directions, coefficients), less what refitting absorbs; 0 for rounding."""
        left: np.ndarray = directions - (directions @ self.tangent.T) @ self.tangent
        size, kept = (directions**2).sum(1), (left**2).sum(1)
        left[kept <= ROUNDING * size] = 0.0
        return left

    def gain(self, off_tangent: np.ndarray, one_sided: bool = False) -> float:
        """Return the nats that these directions, (directions, coefficients), could gain, to first order.

        A single one-sided direction counts only with a positive factor.
        """
        alive = np.linalg.norm(off_tangent, axis=1) > 0.0
        coefficients = self.coefficients(off_tangent[alive])
        if one_sided and len(coefficients) and coefficients[0] < 0:
            return 0.0
        return self.gained(self.left - coefficients @ off_tangent[alive])

    def coefficients(self, off_tangent: np.ndarray) -> np.ndarray:
        """(directions,): best factors of directions, (directions, coefficients), none of them all zeros."""
        gram, right = off_tangent @ off_tangent.T, off_tangent @ self.left
        return solve(gram, right)

    def gained(self, whitened: np.ndarray) -> float:
        """Return the nats by which a whitened residual, (coefficients,), is better than the present one."""
        return float((self.chain.weighting.of_squares(self.squares(whitened)) - self.before).sum())

    def directions(self, member: EffectTerm) -> np.ndarray:
        """Return what a member adds to the output at its start values, (directions, coefficients)."""
        found = []
        for one in separate(member):
            hypothesis = self.now.hypothesis.plus(one)
            parts = []
            for i in range(len(self.records)):
                moved = self.chain.output(hypothesis, self.now.weights, i) - self.bases[i]
                parts.append(self.chain.whitened(i, np.nan_to_num(moved)[None])[0])
            found.append(np.concatenate(parts))
        if member.effect.hold:
            # While no static model fits, the fitted output is no guide: the principal row is tried as well.
            found.append(self.of_inputs(member, ())[0])
        return np.array(found)

    def of_inputs(self, member: EffectTerm, aux: Sequence[str]) -> np.ndarray:
        """Return a dynamic block's response to voltage and auxiliary signals, (signals, coefficients)."""
        hypothesis, found = self.now.hypothesis.plus(member), []
        for i, record in enumerate(self.records):
            # The first row of a mixed hysteresis is its fitted combination, the second the principal one.
            principal = self.chain.rows(hypothesis, i)[: min(2, hypothesis.nominal.kept)][-1]
            rows = np.stack([principal, *(record.aux[name] for name in aux)])
            found.append(self.chain.whitened(i, self.chain.moved(hypothesis, rows, i)))
        return np.concatenate(found, axis=1)


def sizes_of(member: EffectTerm) -> list[str]:
    """Return the numbers that set a member's size: it vanishes at 0, with no kink or jump on the way."""
    effect = member.effect
    if signed(member) or member.own:
        return []
    rough = {*effect.jumps, *effect.kinks, *effect.kinds}
    return [n for n, value in member.shared.items() if effect.identity[n] == 0.0 < value and n not in rough]


def signed(member: EffectTerm) -> bool:
    """Whether any parameter of a member may take either sign."""
    return any(member.effect.quantities[name].at_least < 0 for name in all_names(member))


def all_names(member: EffectTerm) -> set[str]:
    return set(member.shared) | {name for own in member.own for name in own}


def separate(member: EffectTerm) -> list[EffectTerm]:
    """Return one member for each signed parameter, with the other signed ones at their identity."""
    free = signed_numbers(member)
    return [scaled(member, {one: float(one == which) for one in free}) for which in free] or [member]


def signed_numbers(member: EffectTerm) -> list[tuple[str, int | None]]:
    """Return the parameters that may take either sign: name, and recording if it is specific to one."""
    quantities = member.effect.quantities
    each = [(None, member.shared), *enumerate(member.own)]
    return [(name, record) for record, own in each for name in own if quantities[name].at_least < 0]


def scaled(member: EffectTerm, factors: Mapping[tuple[str, int | None], float]) -> EffectTerm:
    """Multiply numbers of a member by factors, within their bounds; a factor of 0 gives the identity."""
    quantities, identity = member.effect.quantities, member.effect.identity

    def of(values: Parameters, record: int | None) -> Parameters:
        found = dict(values)
        for name in values:
            if (name, record) in factors:
                factor = factors[name, record]
                found[name] = quantities[name].nearest(factor * values[name]) if factor else identity[name]
        return found

    own = tuple(of(values, record) for record, values in enumerate(member.own))
    return replace(member, shared=of(member.shared, None), own=own)


def candidates_of(
    effect: type[Effect] | type[InsideEffect],
    records: Sequence[Record],
    starts: Sequence[Parameters],
    aux: Sequence[str],
) -> list[EffectTerm]:
    """Return the starts of an effect as members, with separate per-recording parameters for each recording.

    Starts outside the bounds are left out: they occur with recordings in extreme units or at extreme rates.
    """
    members = []
    for start in starts:
        if not possible(effect, start):
            continue
        shared = {n: v for n, v in start.items() if n not in effect.per_recording}
        each = {n: v for n, v in start.items() if n in effect.per_recording}
        own = tuple(dict(each) for _ in records) if each else ()
        if effect.relative:
            places = range(len(records))
            members += [
                EffectTerm(effect, shared, tuple(dict(each) if i == other else {} for i in places))
                for other in places
            ]
            continue
        members += (
            [EffectTerm(effect, shared, own, a) for a in aux]
            if effect.takes_aux
            else [EffectTerm(effect, shared, own)]
        )
    return members


def possible(effect: type[Effect] | type[InsideEffect] | type[ModalEffect], start: Parameters) -> bool:
    """Whether every number of a start lies within its bounds."""
    return all(
        effect.quantities[name].at_least <= value <= effect.quantities[name].at_most
        for name, value in start.items()
    )
