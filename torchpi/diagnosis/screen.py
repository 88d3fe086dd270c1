"""Screen: how much of the residual each candidate could explain, before any refit.

A candidate's direction is what it adds to the output from its start. Projected off the tangent of the
present hypothesis, so that what refitting would swallow does not count, it says how much of the squared
residual it takes away at most: one pass of the chain a start.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.fit import jacobian
from torchpi.diagnosis.hypothesis import Fit, Member
from torchpi.diagnosis.records import Record
from torchpi.stage.effects.effect import Effect, Parameters
from torchpi.stage.effects.inside import InsideEffect


@dataclass(frozen=True)
class Candidate:
    """A start of an effect."""

    member: Member
    gain: float
    """Share of the squared training residual that it could take away."""
    held: bool
    """Of the hypothesis that it was screened on."""


class Screen:
    """The present fit, made ready to project candidates off its tangent."""

    def __init__(self, chain: Chain, now: Fit) -> None:
        self.chain, self.now, records = chain, now, chain.records
        self.records = records
        tangents, self.bases = [], []
        for i in range(len(records)):
            y, part = jacobian(self.chain, now.hypothesis, now.weights, now.slots, now.theta, i)
            self.bases.append(y)
            tangents.append(part)
        gram = sum(part @ part.T for part in tangents)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
        scaled = gram * scale * scale[:, None]
        scaled[np.diag_indices_from(scaled)] += 1e-9
        self.factor = np.linalg.inv(np.linalg.cholesky(scaled)) * scale
        self.tangents = tangents
        self.residual = np.concatenate([e[r.fitted] for r, e in zip(records, now.residuals, strict=True)])
        self.total = float(self.residual @ self.residual)
        self.explained = self.factor @ sum(
            part @ e[r.fitted] for part, r, e in zip(tangents, records, now.residuals, strict=True)
        )

    def candidate(self, member: Member) -> Candidate:
        """Its gain, 0 if it moves nothing."""
        one_sided = not (signed(member) or member.effect.hold)
        gain = self.gain(self.directions(member), one_sided)
        return Candidate(member, gain, self.now.hypothesis.held)

    def gain(self, directions: list[list[np.ndarray]], one_sided: bool = False) -> float:
        """Share of the squared residual that these directions take away, off the tangent.

        Each direction has one part, its training samples, for each recording; a single one-sided direction
        counts only with a positive factor.
        """
        projected = self.factor @ sum(self._against(directions, i) for i in range(len(self.records)))
        stacked = np.array([np.concatenate(d) for d in directions])
        gram = stacked @ stacked.T - projected.T @ projected
        right = stacked @ self.residual - projected.T @ self.explained
        size = np.diag(stacked @ stacked.T)
        alive = (size > 0) & (np.diag(gram) > 1e-7 * size)
        if not alive.any() or self.total == 0.0:
            return 0.0
        gram, right = gram[np.ix_(alive, alive)], right[alive]
        spread = np.sqrt(np.diag(gram))
        unit = gram / spread / spread[:, None] + 1e-9 * np.eye(len(spread))
        coefficients = np.linalg.solve(unit, right / spread)
        if one_sided and coefficients[0] < 0:
            return 0.0
        return float(coefficients @ (right / spread)) / self.total

    def _against(self, directions: list[list[np.ndarray]], i: int) -> np.ndarray:
        against: np.ndarray = self.tangents[i] @ np.array([d[i] for d in directions]).T
        return against

    def directions(self, member: Member) -> list[list[np.ndarray]]:
        """For each direction, its training part in each recording."""
        found = []
        for one in separate(member):
            hypothesis = self.now.hypothesis.plus(one)
            parts = []
            for i, record in enumerate(self.records):
                moved = self.chain.output(hypothesis, self.now.weights, i) - self.bases[i]
                parts.append(np.nan_to_num(moved[record.fitted]))
            found.append(parts)
        if member.effect.hold:
            found.append(self.of_the_voltage(member))
        return found

    def of_the_voltage(self, member: Member) -> list[np.ndarray]:
        """What a dynamic block makes of the voltage: where nothing static fits, the output is no guide."""
        return self.of_inputs(member, ())[0]

    def of_inputs(self, member: Member, aux: Sequence[str]) -> list[list[np.ndarray]]:
        """What a dynamic block makes of the voltage, and of auxiliary signals beside it."""
        hypothesis = self.now.hypothesis.plus(member)
        found: list[list[np.ndarray]] = [[] for _ in range(1 + len(aux))]
        for i, record in enumerate(self.records):
            # The fitted combination of a mixed hysteresis is its first row, the principal one its second.
            principal = self.chain.rows(hypothesis, i)[:2][-1]
            rows = np.stack([principal, *(record.aux[name] for name in aux)])
            for parts, moved in zip(found, self.chain.moved(hypothesis, rows, i), strict=True):
                parts.append(moved[record.fitted])
        return found


def signed(member: Member) -> bool:
    """Whether its parameters may take either sign."""
    return any(member.effect.quantities[name].at_least < 0 for name in all_names(member))


def all_names(member: Member) -> set[str]:
    return set(member.shared) | {name for own in member.own for name in own}


def separate(member: Member) -> list[Member]:
    """One member for each signed parameter, the other signed ones at their identity."""
    quantities, identity = member.effect.quantities, member.effect.identity
    free: list[tuple[str, int | None]] = [
        (name, None) for name in member.shared if quantities[name].at_least < 0
    ]
    free += [
        (name, record)
        for record, own in enumerate(member.own)
        for name in own
        if quantities[name].at_least < 0
    ]
    if not free:
        return [member]

    def only(which: tuple[str, int | None]) -> Member:
        shared = {
            name: value if (name, None) == which or quantities[name].at_least >= 0 else identity[name]
            for name, value in member.shared.items()
        }
        own = tuple(
            {
                name: value if (name, record) == which or quantities[name].at_least >= 0 else identity[name]
                for name, value in values.items()
            }
            for record, values in enumerate(member.own)
        )
        return Member(member.effect, shared, own, member.aux)

    return [only(which) for which in free]


def candidates_of(
    effect: type[Effect] | type[InsideEffect],
    records: Sequence[Record],
    starts: Sequence[Parameters],
    aux: Sequence[str],
) -> list[Member]:
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
        if effect.name == "load_change":
            # One recording with another load than the rest: the others keep the identity.
            for loaded in range(len(records)):
                members.append(
                    Member(
                        effect, shared, tuple(dict(each) if i == loaded else {} for i in range(len(records)))
                    )
                )
            continue
        members += (
            [Member(effect, shared, own, a) for a in aux]
            if effect.takes_aux
            else [Member(effect, shared, own)]
        )
    return members


def possible(effect: type[Effect] | type[InsideEffect], start: Parameters) -> bool:
    """Whether every number of a start lies within its bounds."""
    return all(
        effect.quantities[name].at_least <= value <= effect.quantities[name].at_most
        for name, value in start.items()
    )
