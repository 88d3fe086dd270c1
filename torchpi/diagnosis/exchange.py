"""Exchange of accepted effects for other forms of them, or for other effects in their place."""

from collections import Counter
from collections.abc import Callable
from dataclasses import replace

from torchpi.diagnosis.contest import HEAT, STEPS
from torchpi.diagnosis.fit import ROUGH
from torchpi.diagnosis.hypothesis import EffectTerm, Fit, Hypothesis
from torchpi.diagnosis.parallel import Job, screen_all
from torchpi.diagnosis.timing import Timing
from torchpi.stage.effects.effect import Described
from torchpi.stage.effects.mechanics.modal import ModalEffect


class Exchange(Timing):
    """Fits on given records, in which one effect may replace another."""

    log: Callable[[str], None]

    def swapped(self, now: Fit) -> Fit:
        """Replace effects by other forms of them, or by effects degenerate with them, that predict better.

        The effect accepted first may have absorbed the contribution of effects that were still missing.
        """
        h, jobs = now.hypothesis, self.of_a_simpler_kind(now)
        added = [k for k, m in enumerate(h.members) if m.effect.name not in self.given]
        instead: dict[frozenset[int], list[EffectTerm]] = {}
        for k in added:
            member = h.members[k]
            if issubclass(member.effect, ModalEffect):
                continue
            beside = [j for j in added if j != k and shared_out_among(h.members[j].effect, member.effect)]
            if forms := self.other_forms(member):
                for gone in (frozenset({k}), *(frozenset({k, j}) for j in beside)):
                    instead.setdefault(gone, []).extend(forms)
            alikes = [
                one
                for one in self.starts
                if looks_like(one.effect, member.effect) and one.effect.name not in h.names
            ]
            if alikes:
                instead.setdefault(frozenset({k}), []).extend(alikes)
        without = []
        for gone in instead:
            less = h
            for k in gone:
                less = less.without(h.members[k].effect.name, h.members[k].aux)
            without.append(less)
        bare = self.fits([(less, now.weights, 0, ROUGH) for less in without], now)
        screens = list(zip(bare, instead.values(), strict=True))
        for less, screened in zip(without, screen_all(self.chain, screens, self.executor), strict=True):
            best = {c.member.kind: c.member for c in sorted(screened, key=lambda c: c.gain)}
            jobs += [(less.plus(member), now.weights, STEPS, ROUGH) for member in best.values()]
        jobs += [(one, now.weights, STEPS, ROUGH) for one in self.as_a_lag_and_a_delay(h)]
        fits = self.raced(jobs, now, 2 * HEAT)
        others = [one for one in fits if self.inside(one, now)]
        chosen = max([now, *others], key=self.worth)
        if not self.within_reach(h.members):  # a limit that is no longer reached stands for something else
            reached = (one for one in others if self.within_reach(one.hypothesis.members))
            chosen = max(reached, key=self.worth, default=now)
        if chosen is now:
            return now
        self.log(f"  as {effects_of(chosen)}: {rms_of(chosen)}")
        return chosen

    def of_a_simpler_kind(self, now: Fit) -> list[Job]:
        """Jobs that replace an added effect by one with a subset of its numbers, such as a second mode by
        a single mode. The simulation's own effect of that simpler kind, if it has one, is removed.

        The simulation's numbers may be so wrong that no fit, and no choice of timing, could correct them.
        """
        h = now.hypothesis
        given = [member for member in h.members if member.effect.name in self.given]
        absent = [member for member in self.starts if member.effect.name not in h.names and not member.own]
        kinds = {(one.effect, one.form): one for one in (*absent, *given) if one.shared}
        return [
            (replace(less.plus(moved), alignment=alignment), now.weights, 2 * STEPS, ROUGH)
            for added in h.members
            if added not in given
            for simple in kinds.values()
            if simple.effect.block == added.effect.block and {*simple.shared} < {*added.shared}
            for moved in [simple.from_where(added)]
            for less in [h.without(added.effect.name, added.aux).without(simple.effect.name)]
            for alignment in self.alignments
        ]

    def other_forms(self, member: EffectTerm) -> list[EffectTerm]:
        """The starts of an effect's other forms. A form whose numbers include those of the effect, or are
        among them, starts from the effect's present values."""
        found: dict[object, EffectTerm] = {}
        for place, other in enumerate(self.starts):
            if (other.effect, other.aux) == (member.effect, member.aux) and other.form != member.form:
                mine, its = set(member.shared), set(other.shared)
                nested = mine < its or its < mine
                found[other.kind if nested else place] = other.from_where(member) if nested else other
        return list(found.values())

    def richer(self, h: Hypothesis, name: str) -> Hypothesis | None:
        """The hypothesis with an effect in the largest form that includes the numbers of its present form,
        starting from their present values; None if there is none."""
        member = next((m for m in h.members if m.effect.name == name and not m.own), None)
        if member is None:
            return None
        more = [
            start
            for start in self.starts
            if (start.effect, start.aux) == (member.effect, member.aux) and {*member.shared} < {*start.shared}
        ]
        if not more:
            return None
        richest = max(more, key=lambda start: len(start.shared))
        return h.without(name, member.aux).plus(richest.from_where(member))

    def by_form(self) -> list[list[EffectTerm]]:
        """The starts, grouped by effect and form."""
        found: dict[tuple[object, ...], list[EffectTerm]] = {}
        for member in self.starts:
            found.setdefault(member.kind, []).append(member)
        return list(found.values())


def looks_like(one: type[Described], other: type[Described]) -> bool:
    """Whether one effect may be mistaken for another."""
    return one.name in other.degenerate_with or (one.delays and other.delays)


def shared_out_among(one: type[Described], other: type[Described]) -> bool:
    """Whether two effects may share what one of them, in another form, explains alone."""
    return looks_like(one, other) or both_slow(one, other)


def both_slow(one: type[Described], other: type[Described]) -> bool:
    """Whether two effects are slow: the laws of such effects differ from rig to rig, and what one does not
    describe looks like another."""
    return one.time_scale == other.time_scale == "slow"


def rms_of(one: Fit) -> str:
    return f"{one.train_rms * 1e3:.3f} nm"


def effects_of(one: Fit) -> str:
    """Return the names of a fit's effects, each with how many there are if it has several."""
    counts = Counter(one.hypothesis.names)
    return ", ".join(name if count == 1 else f"{name} ({count})" for name, count in counts.items())
