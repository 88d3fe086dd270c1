"""Decide which effects are named, and what they leave unexplained."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from math import exp, hypot

import numpy as np

from torchpi.diagnosis.contest import FAINT, PRIOR
from torchpi.diagnosis.diagnosis import (
    EXPLAINED,
    AcrossRecordings,
    NamedEffect,
    OpenCause,
    Parameter,
    Verdict,
)
from torchpi.diagnosis.hypothesis import Fit
from torchpi.diagnosis.intervals import covariance_90, distance_from_none, intervals_90
from torchpi.diagnosis.noise import Noise
from torchpi.diagnosis.parameters import parameters_of, shape_parameters
from torchpi.diagnosis.posterior import AS_LIKELY, STEEPNESS, Believed, form_of
from torchpi.diagnosis.rival_models import OPERATOR_NAME
from torchpi.diagnosis.search import Search
from torchpi.stage.effects.effect import Described
from torchpi.stage.effects.inside import InsideEffect
from torchpi.stage.effects.mechanics.backlash import Backlash

NAMED = 0.5
"""Probability from which an effect is named: the name is more likely right than wrong."""
POSSIBLE = 1.0 / (1.0 + exp(-PRIOR))
"""Probability above which an effect that cannot be named is reported as open: the prior probability."""
CLOSED: tuple[Verdict, ...] = ("nothing_missing", "explained")
"""Verdicts that leave nothing to look for."""
DONE = 1.15
"""Multiple of the measured noise within which nothing is left to explain."""
OPERATORS = {
    "prandtl_ishlinskii": "y = F + Σ w_i h_i: plays added to the simulation F",
    "preisach": "y = Σ g_i(h_i): a Preisach operator in play form",
    "bouc_wen": "dz/dv = 1/σ [1 - |z|ⁿ (1 - β + β sgn(z dv))]: Bouc–Wen",
    "duhem": "y = Σ g_i(h_i) + d, dd = α|dv| (f(v) - d): Preisach and Duhem",
}


@dataclass(frozen=True, eq=False)
class Decision:
    """The named effects, and what they leave."""

    verdict: Verdict
    effects: tuple[NamedEffect, ...]
    open: tuple[Believed, ...]
    """Effects of the final hypothesis that are too uncertain to be named."""
    unexplained_share: float
    joint_share: float
    """Share of the squared residual that several effects explain jointly, none of them given the others."""
    noise_um: float | None
    """Noise of a reading, if it was measured."""
    carries_over: bool = True
    """Whether the recordings determine the hysteresis for other motions, as far as that was tested."""

    @property
    def causes_left_open(self) -> tuple[OpenCause, ...]:
        """The open effects that are likely enough to be reported."""
        return tuple(
            OpenCause(one.name, one.probability, one.alternatives)
            for one in self.open
            if POSSIBLE < one.probability < NAMED
        )


def decide(
    search: Search,
    retuned: Fit,
    final: Fit,
    believed: Sequence[Believed],
    noise: Noise | None,
    structured: bool,
    loud: bool,
) -> Decision:
    """Name the effects that are more likely missing than not.

    Args:
        search: The finished search, with the recordings.
        retuned: The simulation, retuned.
        final: The fit with which the search ended.
        believed: The effects of that fit, with their probabilities.
        noise: The measured noise, if any.
        structured: Whether the remaining residual can be predicted from the voltage, or is not white.
        loud: Whether a recording, a stretch or a frequency stands out of the remaining residual.
    """
    floor_um = noise.rms_um if noise is not None else 0.0
    faint = (FAINT * (floor_um or final.train_rms)) ** 2
    covariance = covariance_90(search.chain, final)
    spans = intervals_90(final, covariance)
    believed = [clear_of_none(one, final, covariance) for one in believed]
    if not search.slips and not leaves_little(final, noise, structured):
        kin = of_a_hysteresis(search.effects_tried)
        believed = [
            replace(one, probability=min(one.probability, AS_LIKELY)) if one.name in kin else one
            for one in believed
        ]
    names = {
        one.name
        for one in believed
        if one.probability >= NAMED
        and one.explained_um2 >= faint
        and not (search.jump and one.name == Backlash.name)
    }
    believed = without_forms(believed, names, final, floor_um)
    above = max(final.train_rms**2 - floor_um**2, 0.0) if noise is not None else 0.0
    removed = retuned.train_rms**2 - max(final.train_rms, floor_um) ** 2
    believed, joint = with_all_attributed(believed, removed)
    # What each effect explains given the others, plus what is left, may exceed what was there before.
    explained = sum(max(one.explained_um2, 0.0) for one in believed)
    total = max(retuned.train_rms**2 - floor_um**2, above + explained, 1e-300)
    known = {effect.name: effect for effect in search.effects_tried}
    named = []
    for one in believed:
        if one.name not in names:
            continue
        share = min(1.0, max(0.0, one.explained_um2 / total))
        if one.name == OPERATOR_NAME:
            family = final.hypothesis.nominal.family
            numbers = (Parameter("family", family, "", None), *shape_parameters(final, spans))
            named.append(
                NamedEffect(one.name, "actuator", one.alternatives, one.probability, numbers, share,
                            OPERATORS[family], "static: the same at any rate", one.rivals)
            )  # fmt: skip
            continue
        effect = known[one.name]
        named.append(
            NamedEffect(one.name, effect.block, one.alternatives, one.probability,
                        parameters_of(search, final, spans, one.name), share, effect.equation,
                        effect.signature, one.rivals, form_of(final, one.name))
        )  # fmt: skip
    named.sort(key=lambda effect: -effect.share)
    left = tuple(one for one in believed if one.name not in names and one.explained_um2 >= faint)
    above += sum(max(one.explained_um2, 0.0) for one in left)
    found = verdict(named, bool(left) or loud, final, noise, structured)
    share = 0.0 if found == "nothing_missing" else min(1.0, above / total)
    return Decision(
        found, tuple(named), left, share, joint / total,
        noise.rms_um if noise is not None else None,
    )  # fmt: skip


def without_forms(
    believed: Sequence[Believed], names: Collection[str], final: Fit, floor_um: float
) -> list[Believed]:
    """Merge remainders that are due to the inexact form of a named effect into that effect. Such a remainder
    leaves no further cause open, provided that the error would count as explained without it."""
    forms = [
        one
        for one in believed
        if one.name not in names
        and one.form_of in names
        and final.train_rms**2 + one.explained_um2 < (EXPLAINED * floor_um) ** 2
    ]
    return [
        replace(
            one,
            explained_um2=one.explained_um2
            + sum(max(form.explained_um2, 0.0) for form in forms if form.form_of == one.name),
        )
        for one in believed
        if one not in forms
    ]


def with_all_attributed(believed: Sequence[Believed], removed_um2: float) -> tuple[Sequence[Believed], float]:
    """Attribute all that the fit removed: what no effect explains given the others is explained by several
    of them jointly, and is returned, µm²; the only effect that is likely explains all of it."""
    rest = max(removed_um2 - sum(max(one.explained_um2, 0.0) for one in believed), 0.0)
    likely = [one for one in believed if one.probability > POSSIBLE] or believed
    if len(likely) != 1:
        return believed, rest if believed else 0.0
    (only,) = likely
    whole = replace(only, explained_um2=max(only.explained_um2, 0.0) + rest)
    return [whole if one is only else one for one in believed], 0.0


def if_it_carries_over(
    decision: Decision,
    across: Sequence[AcrossRecordings],
    another_um: float | None = None,
    left_um: float = 0.0,
    untested: bool = False,
) -> Decision:
    """Downgrade "explained" to "partly_explained" if a model that fits these motions may not fit the next.

    Args:
        decision: What was decided on the recorded motions.
        across: Each recording, predicted from the others.
        another_um: The standard deviation of the prediction of another motion; None if it was not computed.
        left_um: The noise, or what the model leaves where the noise was not measured: the standard deviation
            may increase it by no more than the factor up to which a residual counts as explained.
        untested: Whether the held-out samples are too uniform to test the hundreds of weights of a larger
            hysteresis. Then at least one recording has to be predicted from others.
    """
    carries_over = all(one.predicted for one in across)
    if another_um is not None:
        carries_over &= hypot(another_um, left_um) <= EXPLAINED * left_um and not (untested and not across)
    downgraded = decision.verdict == "explained" and not carries_over
    return replace(
        decision,
        verdict="partly_explained" if downgraded else decision.verdict,
        carries_over=carries_over,
    )


def clear_of_none(one: Believed, final: Fit, covariance: np.ndarray) -> Believed:
    """Lower the probability of an effect to at most one half where the intervals of its numbers just reach
    those of no effect: a name beside a number that may as well be 0 is no answer. What follows a recorded
    signal is there, however differently two recordings follow it."""
    if one.recorded:
        return one
    distance = distance_from_none(final, covariance, one.name)
    clear = 1.0 / (1.0 + distance**-STEEPNESS) if distance > 0 else 0.0
    return replace(one, probability=round(one.probability * clear, 4))


def of_a_hysteresis(effects: Collection[type[Described]]) -> set[str]:
    """Return the names of effects that are a hysteresis or change one: beside a residual that nothing
    explains, a hysteresis of an unlisted family is as likely."""
    return {one.name for one in effects if issubclass(one, InsideEffect) or one.sticks}


def leaves_little(final: Fit, noise: Noise | None, structured: bool, factor: float = EXPLAINED) -> bool:
    """Whether a fit leaves no more than this multiple of the noise, or nothing structured if that was not
    measured."""
    if noise is None:
        return not structured
    return max(final.heldout_rms, final.train_rms) < factor * noise.rms_um


def verdict(
    named: Sequence[NamedEffect], more: bool, final: Fit, noise: Noise | None, structured: bool
) -> Verdict:
    """Say in one word how much the named effects explain."""
    done = leaves_little(final, noise, structured, DONE)
    explained = leaves_little(final, noise, structured)
    if not named:
        return "nothing_missing" if done and not more else "unexplained"
    return "explained" if explained and not more else "partly_explained"
