"""Fits against one another: what each is worth under the one score, and which is worth another step."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from math import log

import numpy as np

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.coverage import follows_command, repeats
from torchpi.diagnosis.fit import ROUGH
from torchpi.diagnosis.hypothesis import EffectTerm, Fit
from torchpi.diagnosis.noise import Noise
from torchpi.diagnosis.parallel import Job, fit_all
from torchpi.diagnosis.records import seen
from torchpi.diagnosis.reduced_basis import reduced
from torchpi.diagnosis.score import Gain, Weighting, gain
from torchpi.diagnosis.sensitivity import Near

PRIOR = log(1 / 20)
"""Log odds that any one effect is missing before the recordings are seen: one or two of some twenty are."""
ACCEPTED = 0.95
"""Probability of predicting better from which the search goes on with an effect."""
FAINT = 0.2
"""Of the noise, or of the rms that is left: what explains less is of no use to a user, and a solver's error
does as much."""
ADEQUATE = 0.25
"""Share of what is to be explained where an effect acts from which a search goes on with it: as much as each
of four that act in the same place."""
TOGETHER = 2.0
"""Standard errors within which two hypotheses predict alike."""
CLEAR = 6.0
"""Standard errors by which a fit that has not ended may lose and still go on."""
STEPS = 6
"""Of a fit in the search."""
HEAT = 2
"""Steps after which only what may still win goes on."""


@dataclass(frozen=True, eq=False)
class Tried:
    """A hypothesis that was fitted in a round."""

    name: str
    fit: Fit
    gain: Gain
    """Over the hypothesis before, the prior included."""


class Contest:
    """Fits on given records.

    Args:
        chain: The recordings, and what each coefficient counts.
        noise: What was measured of it, if anything.
        executor: Where independent fits run; None is this process.
    """

    def __init__(self, chain: Chain, noise: Noise | None, executor: Executor | None) -> None:
        self.chain, self.noise, self.executor = chain, noise, executor
        self.repeating, self.seen = repeats(chain.records), seen(chain.records)

    def fits(self, jobs: Sequence[Job], around: Fit | None = None) -> list[Fit]:
        """Each hypothesis fitted from its weights, in the executor if there is one, with the sensitivities of
        the fit around which they are, if there is one."""
        near = Near(around.hypothesis, around.weights) if around is not None else None
        return fit_all(self.chain, jobs, self.executor, near)

    def fits_here(self, jobs: Sequence[Job]) -> list[Fit]:
        """Each hypothesis fitted in this process, while others begin."""
        return fit_all(self.chain, jobs, None)

    def raced(self, jobs: Sequence[Job], now: Fit, heat: int = HEAT) -> list[Fit]:
        """Fitted for a few steps each, and to the end where the outcome against a fit is not yet clear."""
        fits = self.fits([(h, w, min(heat, steps), tolerance) for h, w, steps, tolerance in jobs], now)
        unclear = [k for k, one in enumerate(fits) if self.near(one, now)]
        rest: list[Job] = [(fits[k].hypothesis, fits[k].weights, jobs[k][2], jobs[k][3]) for k in unclear]
        for k, one in zip(unclear, self.fits(rest, now), strict=True):
            fits[k] = one
        return fits

    def near(self, one: Fit, now: Fit) -> bool:
        """Whether a fit that has not ended may still be the better one."""
        ahead = self.over(now, one)
        return ahead.nats < CLEAR * ahead.sd

    def weigh(self, now: Fit) -> None:
        """Count every coefficient for what this fit leaves there, and for the noise."""
        self.chain.weighting = Weighting.of(self.chain.records, now.residuals, self.noise)

    def reweighted(self, now: Fit) -> Fit:
        """The fit on few rows, under the weights that it shows itself."""
        self.weigh(now)
        small = reduced(self.chain, now)
        (again,) = self.fits([(small.hypothesis, small.weights, 3, ROUGH)])
        return again

    def score(self, one: Fit) -> float:
        """Its log density."""
        return float(self.chain.weighting.log_density(one).sum())

    def worth(self, one: Fit) -> float:
        """Its log density, less what every number costs beside that: a form of fewer numbers is preferred,
        and no delay of what is taken for early."""
        return self.score(one) + PRIOR * (len(one.slots) - min(one.hypothesis.alignment, 0))

    def over(self, better: Fit, worse: Fit, prior: float = 0.0) -> Gain:
        """By how much one fit predicts better than another."""
        w = self.chain.weighting
        return gain(w.log_density(better), w.log_density(worse), prior, w.strata)

    def prior(self, now: Fit, more: Fit) -> float:
        """Log odds of what a hypothesis has beyond another."""
        new = len(set(more.hypothesis.names)) - len(set(now.hypothesis.names))
        grown = more.hypothesis.nominal.family != now.hypothesis.nominal.family
        return PRIOR * (new + grown)

    def as_well(self, one: Fit, best: Fit) -> bool:
        """Whether a fit predicts as well as a better one, within the standard error: no recording here splits
        the two."""
        ahead = self.over(best, one)
        return not ahead.nats > max(TOGETHER * ahead.sd, -PRIOR)

    def faint(self, more: Fit, less: Fit) -> bool:
        """Whether what a fit explains beyond another is of no use to anyone: no name of it could stand."""
        rms_um = self.noise.rms_um if self.noise is not None else more.train_rms
        return explains_less(more, less, FAINT * rms_um)

    def is_noise(self, one: Fit) -> bool:
        """Whether a fit leaves nothing but the noise, where that was measured."""
        return self.noise is not None and one.train_rms < float(np.hypot(1.0, FAINT)) * self.noise.rms_um

    def adequate(self, more: Fit, less: Fit) -> bool:
        """Whether what a fit explains beyond another is a share worth a name of what is to be explained where
        it acts: anything explains a little of what it only resembles."""
        return self.chain.weighting.explained_where_it_acts(more, less) > ADEQUATE

    def inside(self, one: Fit, now: Fit) -> bool:
        """Whether no number ended on a bound that did not before, no limit lies beyond what the command asks
        for, and no line of its own is one that the command has: of what a fit has beyond another, if it has
        more."""
        members = one.hypothesis.members
        there = {member.kind for member in now.hypothesis.members}
        new = {k for k, member in enumerate(members) if member.kind not in there}
        # What an addition makes of a number that was there before is for the backward step to judge.
        bounded = [slot.name for slot in one.on_a_bound if not new or slot.member in {-1, *new}]
        added = [member for k, member in enumerate(members) if not new or k in new]
        return (
            set(bounded) <= set(now.bounded)
            and self.within_reach(added)
            and not any(self.follows_command(member) for member in added)
        )

    def follows_command(self, member: EffectTerm) -> bool:
        """Whether an effect has a line, and stands in no recording but where the command has it as well."""
        line_hz = member.effect.line_hz(member.shared)
        if line_hz is None:
            return False
        power = [sum(size**2 for size in own.values()) for own in member.own]
        power = power or [1.0] * len(self.repeating)  # the same in each
        return follows_command(line_hz, power, self.repeating)

    def within_reach(self, members: Sequence[EffectTerm]) -> bool:
        """Whether the command asks for what each limit among these allows, and more."""
        return all(member.effect.reached(member.shared, self.seen) for member in members)

    def needs_no_history(self, now: Fit, less: Fit) -> bool:
        """Whether recordings that start de-energised are predicted as well, or all but as well.

        What a history explains lies where a recording begins: the scatter of the cells says nothing of it.
        That of each recording is as unlikely beforehand as an effect.
        """
        prior = PRIOR * len(self.chain.records)
        return explains_less(now, less, FAINT * less.train_rms) or self.over(now, less, prior).nats < 0


def explains_less(more: Fit, less: Fit, rms_um: float) -> bool:
    """Whether what a fit explains beyond another has a smaller rms than this."""
    return less.train_rms**2 - more.train_rms**2 < rms_um**2
