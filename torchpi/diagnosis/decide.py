"""Decide: which names stand, what else they could be called, and how sure that is."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from torchpi.diagnosis.compressed import compressed
from torchpi.diagnosis.diagnosis import NamedEffect, Parameter, Rival, Verdict
from torchpi.diagnosis.fit import fit, to_outer, value_at
from torchpi.diagnosis.held_out import explained, unexplained
from torchpi.diagnosis.hypothesis import Fit
from torchpi.diagnosis.intervals import intervals_90
from torchpi.diagnosis.model import foretold
from torchpi.diagnosis.search import OPERATOR, Round, Search
from torchpi.diagnosis.slips import Jump
from torchpi.stage.effects import EFFECTS
from torchpi.stage.effects.mechanics.backlash import Backlash
from torchpi.stage.effects.mechanics.stiction import Stiction

OPERATOR_NAME = "hysteresis_operator"
NAMES = {OPERATOR_NAME, *(effect.name for effect in EFFECTS)}
STATIC = (
    "input_nonlinearity", "hysteresis_asymmetry", "incongruent_loops", "sensor_nonlinearity",
    "hysteresis_operator",
)  # fmt: skip
"""Static effects that need each other's forms to be told apart."""
SAME_ERROR = 1.03
"""A rival whose held-out error is within this ratio explains as well."""
SAME_EVIDENCE = 10.0
"""A rival that loses less log-likelihood than this is not refuted."""
ALIKE: dict[str, str] = {
    "amplifier_lag": "sensor_lag",
    "sensor_lag": "amplifier_lag",
    "input_nonlinearity": "sensor_nonlinearity",
    "sensor_nonlinearity": "input_nonlinearity",
}
"""Pairs that no voltage and displacement split for certain: they differ by what stands between them."""
ALIKE_ERROR = 1.5
FAR = 1.1
"""A rival whose held-out error is more than this ratio is refuted by that alone."""
DONE, EXPLAINED = 1.15, 1.5
"""Times the floor: a held-out error within this leaves nothing to explain, or little beside the names."""


@dataclass(frozen=True, eq=False)
class Decision:
    """The names, and what they leave."""

    verdict: Verdict
    effects: tuple[NamedEffect, ...]
    unexplained_share: float


def decide(
    search: Search,
    retuned: Fit,
    final: Fit,
    history: Sequence[Round],
    floor_um: float,
) -> Decision:
    """Name what the search found.

    An effect's share is what the held-out squared error rises by when it alone is taken away, over the
    mismatch of the retuned stage.
    """
    mismatch = max(retuned.heldout_rms**2 - floor_um**2, 1e-300)
    left = max(final.heldout_rms**2 - floor_um**2, 0.0)
    named = []
    small = compressed(search.chain, final)
    spans = intervals_90(search.chain, final)
    for name, less in zip(search.added(final), search.without_each(small), strict=True):
        if search.jump and name == Backlash.name:  # friction while it slides: a part of the stiction
            continue
        effect = next(m.effect for m in final.hypothesis.members if m.effect.name == name)
        rise = less.heldout_rms**2 - small.heldout_rms**2
        rivals = rivals_of(history, name, final.hypothesis.names)
        known = known_share(search, small, less, floor_um)
        named.append(
            NamedEffect(
                name, effect.block, alternatives(rivals, name), probability(name, known, rivals),
                parameters_of(search, final, spans, name), min(1.0, max(0.0, rise / mismatch)),
                effect.equation, effect.signature, rivals,
            )
        )  # fmt: skip
    family = final.hypothesis.nominal.family
    if family != retuned.hypothesis.nominal.family:
        named.append(operator(search, retuned, final, spans, history, mismatch, floor_um))
    named.sort(key=lambda effect: -effect.share)
    found = verdict(named, final, floor_um)
    return Decision(found, tuple(named), 0.0 if found == "nothing_missing" else min(1.0, left / mismatch))


def verdict(named: Sequence[NamedEffect], final: Fit, floor_um: float) -> Verdict:
    """In one word what the names achieve."""
    done = final.heldout_rms < DONE * floor_um
    if not named:
        return "nothing_missing" if done else "unexplained"
    return "explained" if final.heldout_rms < EXPLAINED * floor_um else "partly_explained"


def known_share(search: Search, now: Fit, less: Fit, floor_um: float) -> float:
    """What an effect explains, over that and what nothing explains."""
    rise = explained(search.chain.records, now, less)
    return rise / (rise + unexplained(search.chain.records, now, less, floor_um)) if rise > 0 else 0.0


def rivals_of(history: Sequence[Round], name: str, named: Collection[str]) -> tuple[Rival, ...]:
    """What was tried in its place in the round that took it, the best first; the effect itself among them.

    What is named beside it is no rival.
    """
    taken = next(round for round in reversed(history) if name in (round.accepted or "").split(" + "))
    return tuple(
        Rival(one.name, one.fit.train_rms, one.fit.heldout_rms, one.evidence)
        for one in taken.tried
        if one.name == taken.accepted or one.name not in named
    )


def alternatives(rivals: Sequence[Rival], name: str) -> tuple[str, ...]:
    """The names that these data cannot tell from this one, another operator's hysteresis among them."""
    mine = next(rival for rival in rivals if name in rival.name.split(" + "))
    found = (
        name_of(rival)
        for rival in rivals
        if rival is not mine
        and name_of(rival) in NAMES
        and (
            (
                rival.heldout_rms_um < SAME_ERROR * mine.heldout_rms_um
                and rival.evidence > mine.evidence - SAME_EVIDENCE
            )
            or (ALIKE.get(name) == rival.name and rival.heldout_rms_um < ALIKE_ERROR * mine.heldout_rms_um)
        )
    )
    return tuple(dict.fromkeys(found))


def name_of(rival: Rival) -> str:
    """As in `diagnosis.json`: without the family of an operator."""
    return OPERATOR_NAME if rival.name.startswith(OPERATOR) else rival.name


def probability(name: str, known: float, rivals: Sequence[Rival]) -> float:
    """That the name is right: its known share, against noise, and against its rivals.

    A rival shares by e^{ΔL}, at most as an equal, which halves it: what is held out has decided between them.
    The group of alternatives keeps the whole.
    """
    mine = next(rival for rival in rivals if name in rival.name.split(" + "))
    group = {mine.name, *alternatives(rivals, name)}
    weights = {rival.name: math.exp(min(rival.evidence - mine.evidence, 0.0)) for rival in rivals}
    outside = max(
        (
            weights[rival.name]
            for rival in rivals
            if rival.name not in group
            and name_of(rival) not in group
            and rival.heldout_rms_um < FAR * mine.heldout_rms_um
        ),
        default=0.0,
    )
    noise = 1.0 / (1.0 + math.exp(-min(mine.evidence, 50.0)))
    return round(known * noise / (1.0 + outside), 4)


def parameters_of(
    search: Search, final: Fit, spans: Sequence[tuple[float, float]], name: str
) -> tuple[Parameter, ...]:
    """Fitted parameters of one effect, with intervals.

    Where there are several of its kind, modes or other axes, each has its own, `name[axis 1]`: the
    frequencies of all modes first, then what else they have.
    """
    if search.jump and name == Stiction.name:
        return stiction_parameters(search.jump, final, spans)
    places = [i for i, one in enumerate(final.hypothesis.names) if one == name]
    if len(places) == 1:
        return parameters_of_member(search, final, spans, places[0])
    found: dict[str, list[Parameter]] = {}
    for number, place in enumerate(places, 1):
        label = f"{final.hypothesis.members[place].aux} {number}".strip()
        for one in parameters_of_member(search, final, spans, place):
            found.setdefault(one.name, []).append(replace(one, name=f"{one.name}[{label}]"))
    return tuple(one for each in found.values() for one in each)


def stiction_parameters(
    jump: Jump, final: Fit, spans: Sequence[tuple[float, float]]
) -> tuple[Parameter, ...]:
    """J - d, and d where the data tell it from plays: half of the motion that the slips alone do not lose."""
    value_um, span = jump
    parameters = [Parameter("jump_um", value_um, "µm", span)]
    for slot, (low, high), inner in zip(final.slots, spans, final.theta, strict=True):
        if slot.member >= 0 and final.hypothesis.members[slot.member].effect is Backlash:
            d = to_outer(slot, float(inner)) / 2
            parameters += [
                Parameter("sliding_um", d, "µm", (low / 2, high / 2)),
                Parameter("breakaway_um", value_um + d, "µm", (span[0] + low / 2, span[1] + high / 2)),
            ]
    return tuple(parameters)


def parameters_of_member(
    search: Search, final: Fit, spans: Sequence[tuple[float, float]], index: int
) -> tuple[Parameter, ...]:
    """What each recording has for itself is given for each, `name[recording]`; under its bare name is what
    the augmented stage takes."""
    found: list[tuple[int | None, Parameter]] = []
    own: list[tuple[int | None, Parameter]] = []
    member = final.hypothesis.members[index]
    names = [record.name for record in search.chain.records]
    for slot, span in zip(final.slots, spans, strict=True):
        if slot.member == index:
            one = Parameter(
                slot.name, value_at(final.hypothesis, slot), member.effect.quantities[slot.name].unit, span
            )
            (found if slot.record is None else own).append((slot.record, one))
    shared = [one for _, one in found]
    for name in dict.fromkeys(one.name for _, one in own):
        each = [one for _, one in own if one.name == name]
        alone = len(each) == 1
        shared.append(each[0] if alone else together(each, foretold(member)[name]))
    if len(own) > 1:
        shared += [replace(one, name=f"{one.name}[{names[r or 0]}]") for r, one in own]
    return tuple(shared)


def together(each: Sequence[Parameter], value: float) -> Parameter:
    """The number for a recording that was not made yet; as wide as its kind scatters."""
    spans = [one.interval_90 for one in each if one.interval_90]
    return Parameter(
        each[0].name, value, each[0].unit, (min(low for low, _ in spans), max(high for _, high in spans))
    )


def operator(
    search: Search,
    retuned: Fit,
    final: Fit,
    spans: Sequence[tuple[float, float]],
    history: Sequence[Round],
    mismatch: float,
    floor_um: float,
) -> NamedEffect:
    """The hysteresis itself, where it is not Prandtl–Ishlinskii."""
    nominal = final.hypothesis.nominal
    plain = fit(search.chain, final.hypothesis.on(retuned.hypothesis.nominal), None)
    rise = plain.heldout_rms**2 - final.heldout_rms**2
    grown = next(r for r in history if any(t.name.endswith(nominal.family) for t in r.tried))
    rivals = tuple(
        Rival(t.name.removeprefix(OPERATOR), t.fit.train_rms, t.fit.heldout_rms, t.evidence)
        for t in grown.tried
        if t.name.startswith(OPERATOR) or t.name in STATIC
    )
    # Output functions of plays hold every static form of hysteresis: only a form that failed is excluded.
    flexible = nominal.family == "preisach"
    failed = {rival.name for rival in rivals if rival.heldout_rms_um > 1.2 * final.heldout_rms}
    others = [n for n in ("incongruent_loops", "hysteresis_asymmetry") if flexible and n not in failed]
    return NamedEffect(
        OPERATOR_NAME, "actuator", tuple(others),
        round(known_share(search, final, plain, floor_um), 4),
        (Parameter("family", nominal.family, "", None), *shape_parameters(final, spans)),
        min(1.0, max(0.0, rise / mismatch)),
        FAMILIES[nominal.family],
        "static: survives at any rate, and no other static form removes it", rivals,
    )  # fmt: skip


FAMILIES = {
    "preisach": "y = Σ g_i(h_i): a Preisach operator in play form",
    "bouc_wen": "dz/dv = 1/σ [1 - |z|ⁿ (1 - β + β sgn(z dv))]: Bouc–Wen",
    "duhem": "dz = α|dv| (f(v) - z): Duhem",
}


def shape_parameters(final: Fit, spans: Sequence[tuple[float, float]]) -> list[Parameter]:
    """Numbers of the operator's own shape."""
    units = {"sigma_v": "V", "alpha_per_v": "1/V"}
    return [
        Parameter(slot.name, value_at(final.hypothesis, slot), units.get(slot.name, ""), span)
        for slot, span in zip(final.slots, spans, strict=True)
        if slot.member < 0
    ]
