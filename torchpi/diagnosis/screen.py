"""Screen: how much of the residual each candidate could explain, before any refit.

A candidate's direction is what it adds to the output from its start. Projected off the tangent of the
present hypothesis, so that what refitting would absorb does not count, it says how much better the residual
would be predicted at most: one pass of the chain a start.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.fit import whitener
from torchpi.diagnosis.hypothesis import EffectTerm, Fit
from torchpi.diagnosis.records import Record
from torchpi.diagnosis.sensitivity import jacobian
from torchpi.stage.effects.effect import Effect, Parameters
from torchpi.stage.effects.inside import InsideEffect
from torchpi.stage.effects.mechanics.modal import ModalEffect

RESIZED = (0.02, 3.0)
"""Times its size, at most, that a start becomes: to first order, no more is known."""
ROUNDING = 1e-7
"""Of a squared direction: less than this off the tangent is rounding."""


@dataclass(frozen=True)
class Candidate:
    """A start of an effect."""

    member: EffectTerm
    """With the size that explains most, to first order."""
    gain: float
    """Nats that it could gain, to first order."""
    at_once: float
    """Those that it gains with the numbers that it has, to first order in the others."""


class Screen:
    """The present fit, made ready to project candidates off its tangent."""

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
        """Their gains, 0 where one moves nothing."""
        directions = [self.directions(member) for member in members]
        left = self.off_tangent(np.concatenate(directions))
        parts = np.split(left, np.cumsum([len(each) for each in directions])[:-1])
        return [self.candidate(member, part) for member, part in zip(members, parts, strict=True)]

    def candidate(self, member: EffectTerm, off_tangent: np.ndarray) -> Candidate:
        """A start whose directions these are, (directions, coefficients)."""
        first, factor = off_tangent[0], 1.0
        gain = self.gain(off_tangent, not (signed(member) or member.effect.hold))
        if member.own and signed(member):
            # The output is linear in them: from less, other numbers run away before these are large enough.
            member = self.with_solved(member, off_tangent)
        elif (sizes := sizes_of(member)) and first.any():
            factor = float(np.clip((first @ self.left) / (first @ first), *RESIZED))
            member = self.resized(member, sizes, factor)
        return Candidate(member, gain, gain if signed(member) else self.gained(self.left - factor * first))

    def resized(self, member: EffectTerm, sizes: Sequence[str], factor: float) -> EffectTerm:
        """The member with the numbers that say how much there is of it, times a factor."""
        bounds = member.effect.quantities
        return replace(
            member,
            shared={
                name: min(max(value * factor, bounds[name].at_least), bounds[name].at_most)
                if name in sizes
                else value
                for name, value in member.shared.items()
            },
        )

    def solved(self, member: EffectTerm) -> EffectTerm:
        """A member with as much of each signed number as explains most, to first order in all of them."""
        return self.with_solved(member, self.off_tangent(self.directions(member)))

    def with_solved(self, member: EffectTerm, off_tangent: np.ndarray) -> EffectTerm:
        """The same where its directions, (directions, coefficients), are known."""
        alive, factors = np.linalg.norm(off_tangent, axis=1) > 0.0, np.zeros(len(off_tangent))
        factors[alive] = self.coefficients(off_tangent[alive])
        return scaled(member, dict(zip(signed_numbers(member), factors.tolist(), strict=True)))

    def off_tangent(self, directions: np.ndarray) -> np.ndarray:
        """What refitting cannot absorb of directions, (directions, coefficients); 0 for rounding."""
        left: np.ndarray = directions - (directions @ self.tangent.T) @ self.tangent
        size, kept = (directions**2).sum(1), (left**2).sum(1)
        left[kept <= ROUNDING * size] = 0.0
        return left

    def gain(self, off_tangent: np.ndarray, one_sided: bool = False) -> float:
        """Nats that these directions, (directions, coefficients), could gain, to first order.

        A single one-sided direction counts only with a positive factor.
        """
        alive = np.linalg.norm(off_tangent, axis=1) > 0.0
        coefficients = self.coefficients(off_tangent[alive])
        if one_sided and len(coefficients) and coefficients[0] < 0:
            return 0.0
        return self.gained(self.left - coefficients @ off_tangent[alive])

    def coefficients(self, off_tangent: np.ndarray) -> np.ndarray:
        """(directions,): how much of each, (directions, coefficients), explains most; none is all zeros."""
        gram, right = off_tangent @ off_tangent.T, off_tangent @ self.left
        spread = np.sqrt(np.diag(gram))
        unit = gram / spread / spread[:, None] + 1e-9 * np.eye(len(spread))
        found: np.ndarray = np.linalg.solve(unit, right / spread) / spread
        return found

    def gained(self, whitened: np.ndarray) -> float:
        """Nats that a whitened residual, (coefficients,), is ahead of the present one."""
        return float((self.chain.weighting.of_squares(self.squares(whitened)) - self.before).sum())

    def directions(self, member: EffectTerm) -> np.ndarray:
        """What it adds from its start, (directions, coefficients)."""
        found = []
        for one in separate(member):
            hypothesis = self.now.hypothesis.plus(one)
            parts = []
            for i in range(len(self.records)):
                moved = self.chain.output(hypothesis, self.now.weights, i) - self.bases[i]
                parts.append(self.chain.whitened(i, np.nan_to_num(moved)[None])[0])
            found.append(np.concatenate(parts))
        if member.effect.hold:
            # Where nothing static fits, the output is no guide.
            found.append(self.of_inputs(member, ())[0])
        return np.array(found)

    def of_inputs(self, member: EffectTerm, aux: Sequence[str]) -> np.ndarray:
        """What a dynamic block makes of the voltage and of auxiliary signals, (signals, coefficients)."""
        hypothesis, found = self.now.hypothesis.plus(member), []
        for i, record in enumerate(self.records):
            # The fitted combination of a mixed hysteresis is its first row, the principal one its second.
            principal = self.chain.rows(hypothesis, i)[: min(2, hypothesis.nominal.kept)][-1]
            rows = np.stack([principal, *(record.aux[name] for name in aux)])
            found.append(self.chain.whitened(i, self.chain.moved(hypothesis, rows, i)))
        return np.concatenate(found, axis=1)


def sizes_of(member: EffectTerm) -> list[str]:
    """Its numbers that say how much there is of it: nothing at 0, and no kink or jump in between."""
    effect = member.effect
    if signed(member) or member.own:
        return []
    rough = {*effect.jumps, *effect.kinks, *effect.kinds}
    return [n for n, value in member.shared.items() if effect.identity[n] == 0.0 < value and n not in rough]


def signed(member: EffectTerm) -> bool:
    """Whether its parameters may take either sign."""
    return any(member.effect.quantities[name].at_least < 0 for name in all_names(member))


def all_names(member: EffectTerm) -> set[str]:
    return set(member.shared) | {name for own in member.own for name in own}


def separate(member: EffectTerm) -> list[EffectTerm]:
    """One member for each signed parameter, the other signed ones at their identity."""
    free = signed_numbers(member)
    return [scaled(member, {one: float(one == which) for one in free}) for which in free] or [member]


def signed_numbers(member: EffectTerm) -> list[tuple[str, int | None]]:
    """Its parameters that may take either sign: their names, and the recordings whose own they are."""
    quantities = member.effect.quantities
    each = [(None, member.shared), *enumerate(member.own)]
    return [(name, record) for record, own in each for name in own if quantities[name].at_least < 0]


def scaled(member: EffectTerm, factors: Mapping[tuple[str, int | None], float]) -> EffectTerm:
    """A member with these numbers so many times as large, within their bounds; of 0 at their identity."""
    quantities, identity = member.effect.quantities, member.effect.identity

    def of(values: Parameters, record: int | None) -> Parameters:
        found = dict(values)
        for name in values:
            if (name, record) in factors:
                factor, bounds = factors[name, record], quantities[name]
                moved = min(max(factor * values[name], bounds.at_least), bounds.at_most)
                found[name] = moved if factor else identity[name]
        return found

    own = tuple(of(values, record) for record, values in enumerate(member.own))
    return replace(member, shared=of(member.shared, None), own=own)


def candidates_of(
    effect: type[Effect] | type[InsideEffect],
    records: Sequence[Record],
    starts: Sequence[Parameters],
    aux: Sequence[str],
) -> list[EffectTerm]:
    """The starts of an effect as members, its own parameters given to each recording.

    Starts out of its bounds are left out: recordings in extreme units, or at extreme rates, ask for them.
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
