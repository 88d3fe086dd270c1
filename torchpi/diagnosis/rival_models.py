"""The hypotheses around the final one: each lacks one of its effects, or has a rival in its place."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from torchpi.diagnosis.contest import ACCEPTED, FORM_ERROR, PRIOR, TOLD_APART, nearly_all
from torchpi.diagnosis.exchange import rms_of, shared_out_among
from torchpi.diagnosis.fit import ROUGH, sum_of_squares
from torchpi.diagnosis.growth import OPERATOR
from torchpi.diagnosis.hypothesis import EffectTerm, Fit, Hypothesis
from torchpi.diagnosis.parallel import Job
from torchpi.diagnosis.reduced_basis import reduced
from torchpi.diagnosis.search import Round, Search, is_larger
from torchpi.stage.effects.effect import Effect
from torchpi.stage.effects.inside import InsideEffect
from torchpi.stage.effects.mechanics.modal import ModalEffect

RIVALS = 4
"""Maximum number of rivals from the search history that are fitted in place of an effect."""
OPERATOR_NAME = "hysteresis_operator"
CONVENTION = "timing_convention"
"""Rival of an effect that delays: a delay by whole samples, due to the convention of whoever recorded."""


@dataclass(frozen=True, eq=False)
class Model:
    """A hypothesis around the final one."""

    without: str
    """The effect that it lacks; empty for the final hypothesis."""
    instead: str
    """What takes its place; empty if nothing does."""
    fit: Fit


def settled(search: Search, retuned: Fit, final: Fit, history: Sequence[Round]) -> tuple[Fit, list[Model]]:
    """Return the hypothesis that none of those around it outperforms, and the models around it."""
    for last in (False, True):
        search.weigh(final)
        models = around(search, retuned, reduced(search.chain, final), history)
        now = models[0].fit
        bare = {model.without: model.fit for model in models if not model.instead}
        given_way = {one for one in models[1:] if gives_way(search, now, one, bare[one.without])}
        better = [
            (search.over(one.fit, now, prior(search, retuned, one.fit) - prior(search, retuned, now)), one)
            for one in models[1:]
            if (one in given_way or search.faint(now, one.fit))
            and not (
                one.instead == OPERATOR_NAME
                and any(search.bends_to_all(one.fit, less) for less in (bare[one.without], now))
            )
        ]
        # Within one standard error, fewer parameters win; a model two behind may be much worse. Hundreds of
        # weights that only explain a little of everything win by nothing but their number.
        plainer = [
            (ahead, one)
            for ahead, one in better
            if one.instead not in ("", OPERATOR_NAME)
            and (in_its_place(one) or (len(one.fit.slots), -ahead.nats) < (len(now.slots), 0.0))
            and (
                one in given_way
                or ahead.nats > -max(ahead.sd, -PRIOR)
                or (in_its_place(one) and search.bends_to_all(now, one.fit))
            )
        ]
        ahead, best = max(better, key=lambda pair: pair[0].nats, default=(None, models[0]))
        if ahead is None or last or search.slips:
            break
        if ahead.probability < ACCEPTED:
            if not plainer:
                break
            best = max(plainer, key=lambda pair: pair[0].nats)[1]
        search.log(f"  {best.instead or 'nothing'} in place of {best.without}: {rms_of(best.fit)}")
        final = search.on_its_rows(best.fit)
    return final, models


def gives_way(search: Search, now: Fit, one: Model, bare: Fit) -> bool:
    """Whether a larger hysteresis gives way to a static effect, which it contains: what it explains beyond is
    less than it leaves, and as little as an error in the form of that effect."""
    return (
        in_its_place(one)
        and all(same_place(None, term) for term in terms_instead(one))
        and nearly_all(one.fit, bare, now, FORM_ERROR)
        and search.chain.weighting.explained_of_all(now, one.fit) < TOLD_APART
    )


def in_its_place(one: Model) -> bool:
    """Whether an effect that is no hysteresis stands in place of a larger hysteresis, with its hundreds of
    parameters."""
    larger = OPERATOR_NAME in names_of(one.without)
    return larger and not any(term.effect.sticks for term in terms_instead(one))


def terms_instead(one: Model) -> list[EffectTerm]:
    """Return the effects that stand in the place of what a model lacks."""
    names = names_of(one.instead)
    return [member for member in one.fit.hypothesis.members if member.effect.name in names]


def prior(search: Search, retuned: Fit, one: Fit) -> float:
    """Return the log prior odds of what a hypothesis adds to the retuned simulation."""
    grown = one.hypothesis.nominal.family != retuned.hypothesis.nominal.family
    return PRIOR * (len(search.added(one)) + grown)


def around(search: Search, retuned: Fit, small: Fit, history: Sequence[Round]) -> list[Model]:
    """Fit the final hypothesis, those without one effect, and those with a rival in its place."""
    h = small.hypothesis
    hypotheses: list[tuple[str, str, Hypothesis, np.ndarray | None]] = [("", "", h, small.weights)]
    for name in search.added(small):
        less = h.without(name)
        hypotheses.append((name, "", less, small.weights))
        hypotheses += [(name, label, one, w) for label, one, w in rivals(search, history, name, less, small)]
    if h.nominal.family != retuned.hypothesis.nominal.family:
        plain = h.on(retuned.hypothesis.nominal)
        hypotheses.append((OPERATOR_NAME, "", plain, None))
        hypotheses += [
            (OPERATOR_NAME, label, one, None)
            for label, one, _ in rivals(search, history, OPERATOR_NAME, plain, small)
        ]
    for group in groups(search, small, retuned):
        larger = OPERATOR_NAME in group
        less = h.on(retuned.hypothesis.nominal) if larger else h
        for name in group:
            less = less.without(name)
        together = " + ".join(group)
        hypotheses.append((together, "", less, None if larger else small.weights))
        if larger:  # a kind of hysteresis beside it may bend as well what one static effect bends alone
            hypotheses += [
                (together, label, one, None)
                for label, one, _ in rivals(search, history, OPERATOR_NAME, less, small)
            ]
    jobs: list[Job] = [(one, w, 8, ROUGH) for _, _, one, w in hypotheses]
    # With another hysteresis, or one lag for another, all parameters have far to go: a few steps say nothing
    # about the outcome.
    late = {effect.name for effect in search.effects_tried if effect.delays}
    far = [
        k
        for k, (name, instead, one, _) in enumerate(hypotheses)
        if k == 0 or one.nominal.family != h.nominal.family or {name, instead} <= late
    ]
    found = dict(zip(far, search.fits([jobs[k] for k in far]), strict=True))
    near = [k for k in range(len(jobs)) if k not in found]
    found |= zip(near, search.raced([jobs[k] for k in near], found[0]), strict=True)
    fits = [found[k] for k in range(len(jobs))]
    return [
        Model(name, instead, one)
        for (name, instead, _, _), one in zip(hypotheses, fits, strict=True)
        if instead in ("", CONVENTION) or search.inside(one, small)  # neither is another cause
    ]


def groups(search: Search, small: Fit, retuned: Fit) -> list[tuple[str, ...]]:
    """Return the groups of two or more added effects that may stand in for each other."""
    terms = {member.effect.name: member for member in small.hypothesis.members}
    left, found = search.added(small), []
    if small.hypothesis.nominal.family != retuned.hypothesis.nominal.family:
        left = [OPERATOR_NAME, *left]
    while left:
        group, left = [left[0]], left[1:]
        while kin := [n for n in left if any(same_place(terms.get(n), terms.get(g)) for g in group)]:
            group, left = [*group, *kin], [name for name in left if name not in kin]
        if len(group) > 1:
            found.append(tuple(group))
    return found


def same_place(one: EffectTerm | None, other: EffectTerm | None) -> bool:
    """Whether two effects (None: a larger hysteresis) may each stand in for part of the other: either alone
    is then left out with little loss."""
    if one is not None and other is not None and shared_out_among(one.effect, other.effect):
        return True
    return all(t is None or (t.effect.time_scale == "static" and not t.effect.relative) for t in (one, other))


def rivals(
    search: Search, history: Sequence[Round], name: str, less: Hypothesis, small: Fit
) -> list[tuple[str, Hypothesis, np.ndarray | None]]:
    """Return what may replace an effect: what was tried when it was accepted, and effects that look alike."""
    found: list[tuple[str, Hypothesis, np.ndarray | None]] = []
    there = set(small.hypothesis.names)
    seen: set[str] = set()
    taken = [round for round in history if name in names_of(round.accepted)]
    # An effect that came in by exchange replaces one that was accepted in an earlier round.
    kept = there | {OPERATOR_NAME}
    taken = taken or [one for one in history if one.accepted and not kept & {*names_of(one.accepted)}]
    considered = [round for round in history if any(name in names_of(one.name) for one in round.tried)]
    for round in reversed(taken or considered[-1:]):
        for one in round.tried:
            label = OPERATOR_NAME if is_larger(one) else one.name
            parts = names_of(one.name)
            if label in seen or label == name or name in parts or there & set(parts) or len(seen) >= RIVALS:
                continue
            seen.add(label)
            if label == OPERATOR_NAME:
                larger = one.fit.hypothesis
                found.append((label, less.on(larger.nominal, larger.shape, larger.starts), None))
                continue
            more = less
            for member in one.fit.hypothesis.members:
                if member.effect.name in parts:
                    more = more.plus(member)
            found.append((label, more, small.weights))
            if name == OPERATOR_NAME and (richer := search.richer(more, label)):
                found.append((label, richer, small.weights))
    mine = next((effect for effect in search.effects_tried if effect.name == name), None)
    return found if mine is None else found + of_its_kind(search, history, mine, less, small, seen | there)


def of_its_kind(
    search: Search,
    history: Sequence[Round],
    mine: type[Effect] | type[InsideEffect],
    less: Hypothesis,
    small: Fit,
    there: Collection[str],
) -> list[tuple[str, Hypothesis, np.ndarray | None]]:
    """Return what looks like an effect, each form from where it leaves least, and timing conventions."""
    found: list[tuple[str, Hypothesis, np.ndarray | None]] = []
    if mine.delays:
        # A lag is not a shift by whole samples, but may have been found with a convention that absorbs part.
        others = (a for a in search.alignments if a != less.alignment)
        found += [(CONVENTION, replace(less, alignment=a), small.weights) for a in others]
        # Modes fitted beside a lag take long to follow another convention; those from before it are there.
        found += [(CONVENTION, *one) for one in as_before(search, history, mine.name, less)]
    for starts in search.by_form():
        effect = starts[0].effect
        if effect.name not in there and shared_out_among(effect, mine):
            at = search.alignments if effect.delays and mine.delays else (less.alignment,)
            choices = [replace(less.plus(start), alignment=a) for start in starts for a in at]
            nearest = min(choices, key=lambda one: sum_of_squares(search.chain, one, small.weights))
            found.append((effect.name, nearest, small.weights))
    return found


def as_before(
    search: Search, history: Sequence[Round], name: str, less: Hypothesis
) -> list[tuple[Hypothesis, np.ndarray]]:
    """Return what the search had before an effect came in, if that has another timing convention, and what
    came in since."""
    without = [one.before for one in history if name not in one.before.hypothesis.names]
    if not without:
        return []
    before = without[-1].hypothesis
    since = [member for member in less.members if member.effect.name not in before.names]
    if (
        before.alignment == less.alignment
        or before.nominal.family != less.nominal.family
        or not set(before.names) <= set(less.names)
        or any(issubclass(member.effect, ModalEffect) for member in since)
    ):
        return []
    small = reduced(search.chain, without[-1])
    one = small.hypothesis
    for member in since:
        one = one.plus(member)
    return [(one, small.weights)]


def each_of(labels: Sequence[str], but: str) -> tuple[str, ...]:
    """Return every effect in the names of explanations once, but this one."""
    return tuple(dict.fromkeys(name for label in labels for name in names_of(label) if name != but))


def names_of(label: str | None) -> list[str]:
    """Return the effects in the name of an explanation."""
    if not label:
        return []
    return [OPERATOR_NAME] if label.startswith(OPERATOR) else label.split(" + ")
