"""Probability of each name: the weights of all relevant hypotheses, normalised together.

These are the final hypothesis, those without one of its effects, and those with a rival in its place. Their
weights are those of Bayesian bootstrap model averaging, pseudo-BMA+ of Yao, Vehtari, Simpson and Gelman
(*Bayesian Analysis* 13(3), 2018): a softmax of log predictive densities and prior, averaged over random
weights of the cells, so that a difference counts in units of its own standard error.

An effect may only resemble the true cause. Its name is therefore less probable the smaller the share of the
residual above the noise that it explains: in the cells in which it acts, over all cells, and on the sealed
samples. An effect with a signal of its own, a second input or a line, resembles nothing else. Moreover, if
the equation of one effect is not quite that of the rig, its remainder looks like one of its kin.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from torchpi.diagnosis.clock import within_the_clock
from torchpi.diagnosis.contest import FORM_ERROR, PRIOR, TOLD_APART, nearly_all
from torchpi.diagnosis.coverage import one_motion, one_size
from torchpi.diagnosis.diagnosis import Rival
from torchpi.diagnosis.exchange import both_slow, looks_like, shared_out_among
from torchpi.diagnosis.hypothesis import EffectTerm, Fit, Hypothesis
from torchpi.diagnosis.lines import STANDS_OUT, is_overtone
from torchpi.diagnosis.own_signal import has_a_recorded_signal, has_a_signal_of_its_own, stands_out
from torchpi.diagnosis.records import Record
from torchpi.diagnosis.repeats import APART, STARTING
from torchpi.diagnosis.rival_models import CONVENTION, OPERATOR_NAME, Model, each_of, names_of, prior, settled
from torchpi.diagnosis.score import ALIKE
from torchpi.diagnosis.sealed import confirmed, sealed_error_um2
from torchpi.diagnosis.search import Round, Search
from torchpi.diagnosis.timing import is_whole

DRAWS = 400
HALF, STEEPNESS = 0.72, 6.0
"""Share of the residual above the noise from which a name is more likely right than wrong, and steepness of
this transition. Set on the names of 88 development cases, 45 of them beyond a share of 0.4;
`concealed/judging/calibration.py` measures the resulting calibration."""
FALL = 2.0
"""Steepness of the transition at `FORM_ERROR`, set on the same cases."""
SLOW_FORM_ERROR = 0.02
"""Share, of what a slow effect explains, that another law of its cause may leave: a seventh of its size."""
HYSTERESIS_ERROR, OF_MODES = 0.003, 0.0003
"""FORM_ERROR of a larger hysteresis for any effect; much less for modes, as nothing rate-independent rings,
unless one motion at one rate is all there is: that does not tell a ring from the shape of a loop. Set on 24
further cases: below 0.0003 in four wrong names, 0.0024 in another, 0.0054 in a right one."""
MOST = 0.5
"""Share, of what a timing convention leaves where a delay acts, that a delay must explain to be a cause."""
AS_LIKELY = 0.49
"""Largest probability of a larger hysteresis, or of what it explains as well, where all loops are of one
size. Its output functions then make any two branches and fit whatever repeats with the voltage: a cause that
is not listed is as likely."""
COINCIDENCE = 0.05
"""Probability below which the sizes of an effect in several recordings are not equal by chance: each may be
anything, of either sign, up to the largest."""
LAPSE = 0.02
"""Share of names that are wrong although everything supports them: 0 of some eighty were, which allows up to
0.037 at 95 %."""


@dataclass(frozen=True)
class Believed:
    """One effect of the final hypothesis, or its hysteresis."""

    name: str
    probability: float
    """Probability that it, or one of the alternatives, is missing."""
    alternatives: tuple[str, ...]
    explained_um2: float
    """Increase of the mean square of the residual without it."""
    rivals: tuple[Rival, ...]
    known: float
    """Share of the residual above the noise that it explains, on the fitted and on the sealed samples."""
    form_of: str = ""
    """The effect whose remainder this is more likely than not, because its form is not quite the rig's; empty
    if this is a separate cause."""
    recorded: bool = False
    """Whether it follows a recorded signal, which no error of the model resembles."""


def posterior(
    search: Search, retuned: Fit, final: Fit, history: Sequence[Round]
) -> tuple[Fit, list[Believed]]:
    """Return the best hypothesis, and each of its effects with its probability, the strongest first."""
    final, models = settled(search, retuned, final, history)
    weighting = search.chain.weighting
    density = np.array([weighting.log_density(model.fit) for model in models])
    priors = np.array([prior(search, retuned, model.fit) for model in models])
    chance = averaged(density, priors, weighting.strata)
    found, together, h = [], [], models[0].fit.hypothesis
    signals = {name for name in h.names if has_a_signal_of_its_own(search.chain.records, h, name)}
    whole = is_whole(search.chain, models[0].fit)
    hidden_by_the_clock = within_the_clock(search, final)
    sealed_um2 = sealed_error_um2(search.chain.records, models[0].fit, weighting.mean_floor_um2)
    for name in dict.fromkeys(model.without for model in models if model.without):
        less = without_cause(models, name, search.score, weighting.explained_where_it_acts, whole)
        rivals, alternatives = [], []
        names = {*names_of(name)}
        held = sum(
            float(c) for m, c in zip(models, chance, strict=True) if not names <= {*names_of(m.without)}
        )
        for model, c, own in zip(models, chance, density, strict=True):
            if model.without != name or not model.instead:
                continue
            lost, form = float((density[0] - own).sum()), form_of(model.fit, model.instead)
            rivals.append(Rival(model.instead, model.fit.train_rms, lost, float(c), form))
            stands = cannot_be_ruled_out(search, name, model, less.fit, models[0].fit)
            if model.instead != CONVENTION and stands:
                alternatives.append(model.instead)
                held += float(c)
        # An effect that a hysteresis, driven by the voltage alone, predicts as well may have no own signal.
        own = name in signals and OPERATOR_NAME not in alternatives
        reached = search.within_reach([m for m in h.members if m.effect.name == name])
        reached = reached and not names <= hidden_by_the_clock
        late = already_late(retuned, less.fit, models[0].fit, names)
        without = (less.fit,) if late else (less.fit, retuned)
        recorded = own and has_a_recorded_signal(search, models[0].fit, name)
        known, shown = 0.0, 0.0
        if reached:
            known, shown = share_explained(search, models[0].fit, without, name, own, recorded)
        rise = less.fit.train_rms**2 - models[0].fit.train_rms ** 2
        right = trust(known)
        scales = {member.effect.time_scale for member in h.members if member.effect.name in names}
        if not own and scales and "slow" not in scales:
            right *= beyond_sealed_error(rise, sealed_um2)
        if len(names) > 1:
            together.append(Believed(name, held * right, (), rise, (), shown))
            continue
        rivals.sort(key=lambda rival: rival.loses_nats)
        alternatives += unlisted_hysteresis(h, retuned.hypothesis, name)
        same_each_time = kin_if_the_same_each_time(h, name)
        alternatives += [one.name for one in search.effects_tried if one.name in same_each_time]
        found.append(
            Believed(
                name,
                round(min(held, 1.0) * right, 4),
                tuple(dict.fromkeys(alternatives)),
                rise,
                tuple(rivals),
                shown,
                recorded=recorded,
            )
        )
    left_um = {model.without: model.fit.train_rms for model in models if not model.instead}
    kin_of = {
        mine.name: [its.name for its in search.effects_tried if looks_like(mine, its)]
        for mine in (member.effect for member in h.members)
    }
    found = [as_one(one, found, together, left_um, kin_of) for one in found]
    if one_size(search.chain.records):
        found = [no_likelier_than_unlisted(one) for one in found]
    found.sort(key=lambda one: -one.explained_um2)
    terms = {member.effect.name: member for member in final.hypothesis.members}
    found = with_overtones(found, terms, search.chain.records)
    of_modes = HYSTERESIS_ERROR if one_motion(search.chain.records) else OF_MODES
    found = [apart(one, found, terms, signals, of_modes, together) for one in found]
    return final, [
        replace(one, probability=round(one.probability, 4), alternatives=each_of(one.alternatives, one.name))
        for one in found
    ]


def cannot_be_ruled_out(search: Search, name: str, rival: Model, less: Fit, final: Fit) -> bool:
    """Whether a rival remains an alternative to an effect: it stands as well, or leaves less in addition than
    the best fit leaves and is of the effect's kind, or explains nine tenths of what it does."""
    of = {effect.name: effect for effect in search.effects_tried}
    if stands_as_well(search, name, rival.fit, final):
        return True
    if not {name, rival.instead} <= of.keys():
        return False
    mine, its = of[name], of[rival.instead]
    if both_slow(mine, its) and nearly_all(rival.fit, less, final, SLOW_FORM_ERROR):
        return True
    if search.chain.weighting.explained_of_all(final, rival.fit) >= TOLD_APART:
        return False
    return looks_like(mine, its) or nearly_all(rival.fit, less, final, FORM_ERROR)


def stands_as_well(search: Search, name: str, rival: Fit, final: Fit) -> bool:
    """Whether the data cannot tell an effect, or a larger hysteresis, from its rival: the rival predicts as
    well, or the larger hysteresis only explains a little of everything beyond the rival."""
    bends = name == OPERATOR_NAME and search.bends_to_all(final, rival)
    return bends or search.as_well(rival, final)


def form_of(one: Fit, name: str) -> str:
    """Return which equation of its kind an effect has in a fit; empty if it has only one, or is absent."""
    members = one.hypothesis.members
    return next((m.effect.form(m.values(0)) for m in members if m.effect.name == name), "")


def without_cause(
    models: Sequence[Model],
    name: str,
    score: Callable[[Fit], float],
    explained: Callable[[Fit, Fit], float],
    whole: bool,
) -> Model:
    """Return the model that predicts best without an effect and with no other cause in its place.

    A timing convention is not a cause, so an effect only explains what no convention does. The exception is
    an effect that explains most of what the best convention leaves where it acts, while the readings are not
    late by whole samples: then the lateness is not a convention, and all of it is credited to the effect.
    """
    bare = [model for model in models if model.without == name and model.instead in ("", CONVENTION)]
    best = max(bare, key=lambda model: score(model.fit))
    first = min(bare, key=lambda model: model.fit.hypothesis.alignment)
    later = best.fit.hypothesis.alignment > first.fit.hypothesis.alignment
    return first if later and not whole and explained(models[0].fit, best.fit) > MOST else best


def already_late(retuned: Fit, less: Fit, final: Fit, names: Collection[str]) -> bool:
    """Whether the retuned simulation has, as its timing convention, part of the delay of these effects, which
    the fit without them has not: then it is no simulation without them."""
    delay = any(member.effect.delays for member in final.hypothesis.members if member.effect.name in names)
    return delay and retuned.hypothesis.alignment != less.hypothesis.alignment


def unlisted_hysteresis(h: Hypothesis, before: Hypothesis, name: str) -> list[str]:
    """Return the hysteresis operator as alternative to an effect that is itself a hysteresis, if no larger
    one was accepted: a play behind plays is again plays, and an unlisted family may explain as much."""
    itself = any(member.effect.sticks for member in h.members if member.effect.name == name)
    return [OPERATOR_NAME] if itself and h.nominal.family == before.nominal.family else []


def kin_if_the_same_each_time(h: Hypothesis, name: str) -> tuple[str, ...]:
    """Return what looks like a slow effect of its own in each recording if that is the same in all of them
    by more than chance: then it may follow the voltage, by another law than the effects that were tried."""
    for member in h.members:
        effect, own = member.effect, member.own
        if effect.name != name or effect.time_scale != "slow" or effect.relative or len(own) < 2:
            continue
        each = np.array([[of_one[number] for number in own[0]] for of_one in own])
        spread = np.ptp(each, axis=0) / np.maximum(np.abs(each).max(0), 1e-300)
        if ((spread / 2) ** (len(own) - 1)).max() < COINCIDENCE:
            return tuple(kin for kin in effect.degenerate_with if kin not in h.names)
    return ()


def no_likelier_than_unlisted(one: Believed) -> Believed:
    """Limit the probability of a larger hysteresis, and of an effect that it explains as well."""
    if OPERATOR_NAME not in (one.name, *one.alternatives):
        return one
    return replace(one, probability=min(one.probability, AS_LIKELY))


def as_one(
    one: Believed,
    found: Sequence[Believed],
    together: Sequence[Believed],
    left_um: Mapping[str, float],
    kin_of: Mapping[str, Collection[str]],
) -> Believed:
    """Give the strongest of mutually replaceable effects, the one without which most is left, the probability
    that any of them is missing: if only one is left out, the others replace it, and little is lost. What may
    stand for one of the others may then stand for the strongest, if it is of its kin."""
    for group in together:
        kin = [each for each in found if each.name in names_of(group.name)]
        strongest = max(kin, key=lambda each: left_um[each.name])
        if one is strongest and one.probability < group.probability:
            others = [*one.alternatives, *(each.name for each in kin)]
            others += [name for each in kin for name in each.alternatives if name in kin_of.get(one.name, ())]
            return replace(
                one,
                probability=round(group.probability, 4),
                alternatives=tuple(name for name in dict.fromkeys(others) if name != one.name),
                explained_um2=max(one.explained_um2, group.explained_um2),
            )
    return one


def share_explained(
    search: Search, more: Fit, without: Sequence[Fit], name: str, own_signal: bool, recorded: bool = False
) -> tuple[float, float]:
    """Return the share of the residual above the noise that an effect explains, 0–1, as far as the sealed
    samples confirm it, and the same where they may also show a larger share. For a slow effect they always
    may. For a recorded signal, which nothing else resembles, the share is the probability that it predicts
    better, whatever else is missing.

    Args:
        search: The finished search.
        more: The fit with the effect.
        without: The fit of everything else, and the retuned simulation where that lacks the effect.
        name: The effect.
        own_signal: Whether it has a signal of its own.
        recorded: Whether that is a recorded signal which the voltage does not predict.
    """
    weighting, less = search.chain.weighting, without[0]
    if recorded:
        known = search.over(more, less, PRIOR).probability
    elif stands := stands_out(search.chain.records, more, less, name):
        share = max(1 - (1 - HALF) * STANDS_OUT / stands, 0.0)
        return share, share
    else:
        known = weighting.explained_where_it_acts(more, less)
        if not own_signal:
            known = sqrt(known * weighting.explained_of_all(more, less))
    nats = weighting.nats_of_kinds(more, less)
    apart = float(nats[[STARTING, APART]].sum() / max(float(nats.sum()), 1e-300))
    terms = [member for member in more.hypothesis.members if member.effect.name == name]
    records, floor_um2 = search.chain.records, weighting.mean_floor_um2
    # The sealed samples are later than all others: for a slow effect they are an extrapolation, while those
    # of a motion that was fitted are no new test of a fast or static one.
    slow = not own_signal and {member.effect.time_scale for member in terms} == {"slow"}
    share = confirmed(known, records, more, without, floor_um2, own_signal, apart, either_way=slow, slow=slow)
    if own_signal or slow or one_motion(records):
        return share, share
    return share, confirmed(known, records, more, without, floor_um2, False, apart, either_way=True)


def beyond_sealed_error(explained_um2: float, sealed_um2: float) -> float:
    """Return the probability that what an effect explains is no part of the error that only sealed samples
    show: that of the hysteresis, or of the forms of other effects. An effect that explains less may have been
    fitted to the same error where it does not show."""
    return float(1 / (1 + (sealed_um2 / max(explained_um2, 1e-300)) ** FALL))


def with_overtones(
    found: Sequence[Believed], terms: Mapping[str, EffectTerm], records: Sequence[Record]
) -> list[Believed]:
    """Merge each added line into a stronger one of which it is a harmonic in every recording: a distorted
    mains voltage has many, and those above half the sample rate appear anywhere."""
    hz = {name: term.effect.added_line_hz(term.values(0)) or 0.0 for name, term in terms.items()}

    def of(one: Believed, other: Believed) -> bool:
        lines = hz.get(one.name, 0.0), hz.get(other.name, 0.0)
        return min(lines) > 0 and all(is_overtone(*lines, r.fs_hz, len(r.u) / r.fs_hz) for r in records)

    merged: list[Believed] = []
    for one in found:  # the strongest first
        base = next((k for k, other in enumerate(merged) if of(one, other)), None)
        if base is None:
            merged.append(one)
        else:
            more = merged[base].explained_um2 + one.explained_um2
            merged[base] = replace(merged[base], explained_um2=more)
    return merged


def apart(
    one: Believed,
    found: Sequence[Believed],
    terms: Mapping[str, EffectTerm],
    signals: Collection[str] = (),
    of_modes: float = OF_MODES,
    together: Sequence[Believed] = (),
) -> Believed:
    """Return an effect, its probability multiplied by that of its being a separate cause, not an error in the
    form of another effect; `signals` are the effects that add a signal of their own, `of_modes` is the share
    of what a larger hysteresis explains that may look like a mode, and `together` are groups of effects."""
    left_um2, by = max(
        (
            (
                beside(one, other, found, terms, together)
                * form_error(
                    terms.get(one.name), terms.get(other.name), one.name in signals, one.known, of_modes
                ),
                other.name,
            )
            for other in found
            if other.name != one.name
        ),
        default=(0.0, ""),
    )
    if left_um2 == 0.0 or one.explained_um2 <= 0:
        return one
    another = float(1 / (1 + (left_um2 / one.explained_um2) ** FALL))
    form_of = by if left_um2 > one.explained_um2 else ""
    return replace(one, probability=one.probability * another, form_of=form_of)


def beside(
    one: Believed,
    other: Believed,
    found: Sequence[Believed],
    terms: Mapping[str, EffectTerm],
    together: Sequence[Believed],
) -> float:
    """Return what another effect explains, µm². The strongest of several slow effects is credited with all
    that they explain together, but not what this one adds: where it is left out, they take its place."""
    for group in together:
        names = {*names_of(group.name)} & terms.keys()
        strongest = max(
            (each for each in found if each.name in names), key=lambda each: each.explained_um2, default=None
        )
        if (
            other is strongest
            and one.name in names
            and both_slow(terms[one.name].effect, terms[other.name].effect)
        ):
            return max(other.explained_um2, group.explained_um2 - one.explained_um2)
    return other.explained_um2


def form_error(
    one: EffectTerm | None, other: EffectTerm | None, own_signal: bool, known: float, of_modes: float
) -> float:
    """Return the share, of what another cause explains, that looks like an effect if the form of that cause
    is not quite the rig's.

    A larger hysteresis, passed as None, absorbs part of whatever follows the voltage, and its remainder may
    look like anything that does, most of all like an effect that is itself a hysteresis. It looks less like
    an effect of another kind the larger the share `known` that this effect explains of the residual. The same
    holds for a lag beside a mode, whose damping may have another law.
    """
    if one is None:
        return FORM_ERROR
    if other is None and one.effect.sticks:
        return FORM_ERROR
    if other is None and own_signal and not one.effect.rings:
        return 0.0
    if other is None:
        return (of_modes if one.effect.rings else HYSTERESIS_ERROR) / against_half(known)
    kin = one.effect is not other.effect and (
        shared_out_among(one.effect, other.effect) or other.effect.name in one.effect.left_by
    )
    if kin:
        return FORM_ERROR
    return FORM_ERROR / against_half(known) if one.effect.delays and other.effect.rings else 0.0


def averaged(density: np.ndarray, priors: np.ndarray, strata: np.ndarray | None = None) -> np.ndarray:
    """(models,): pseudo-BMA+ weights from log densities, (models, cells), and log priors; the random weights
    of the cells are normalised within each stratum, (cells,)."""
    rng = np.random.default_rng(0)
    shape, total = 1 / ALIKE**2, np.zeros(len(density))
    relative = density - density[0]
    for _ in range(DRAWS):
        cells = rng.gamma(shape, size=density.shape[1]) / shape
        if strata is not None:
            cells *= (np.bincount(strata) / np.maximum(np.bincount(strata, cells), 1e-300))[strata]
        score = relative @ cells + priors
        weight = np.exp(score - score.max())
        total += weight / weight.sum()
    return total / DRAWS


def trust(known: float) -> float:
    """Return the probability, never 1, that a name is right if its effect explains this share of the residual
    above the noise where it acts."""
    odds = against_half(known)
    return float((1 - LAPSE) * odds**STEEPNESS / (1 + odds**STEEPNESS))


def against_half(known: float) -> float:
    """Return the odds of an explained share over those of `HALF`, from which a name is more likely right."""
    return max(known, 1e-9) / max(1 - known, 1e-9) * (1 - HALF) / HALF
