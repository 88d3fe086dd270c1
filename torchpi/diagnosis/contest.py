"""Comparison of fits: how each ranks under the one score, and which of them deserve further steps."""

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
"""Prior log odds that any one effect is missing: typically one or two of some twenty are."""
ACCEPTED = 0.95
"""Probability of predicting better above which the search accepts an effect."""
FAINT = 0.2
"""Fraction of the noise, or of the remaining rms: an effect that explains less is of no use to a user, and a
solver's error explains as much."""
ADEQUATE = 0.25
"""Share that an effect must explain of what is to be explained where it acts, for the search to accept it: as
much as each of four effects that act in the same place."""
FORM_ERROR = 0.1
"""Share, of what an effect explains, that its kin has to explain to be as likely a separate cause as an error
in the form of that effect. Set on 88 development cases: 0.009 to 0.07 in four wrong names, 0.66 in a right
one."""
TOLD_APART = 0.5
"""Share, of what a fit leaves and what its rival would leave in addition, that the latter must be to rule out
a rival of its kind: where more is left, neither equation is quite that of the rig."""
TOGETHER = 2.0
"""Standard errors within which two hypotheses count as predicting equally well."""
CLEAR = 6.0
"""Standard errors by which an unconverged fit may be behind and still be continued."""
STEPS = 6
"""Maximum number of Gauss–Newton steps of a fit during the search."""
HEAT = 2
"""Gauss–Newton steps after which only fits that may still win are continued."""


@dataclass(frozen=True, eq=False)
class Tried:
    """A hypothesis that was fitted in a round."""

    name: str
    fit: Fit
    gain: Gain
    """Gain over the previous hypothesis, including the prior."""


class Contest:
    """Fits on given records, and their comparison.

    Args:
        chain: The recordings, and the weight of each coefficient.
        noise: The measured noise, if any.
        executor: Runs independent fits; None runs them in this process.
        given: The names of the effects that the simulation already has.
    """

    def __init__(self, chain: Chain, noise: Noise | None, executor: Executor | None, given: set[str]) -> None:
        self.chain, self.noise, self.executor, self.given = chain, noise, executor, given
        self.repeating, self.seen = repeats(chain.records), seen(chain.records)

    def fits(self, jobs: Sequence[Job], around: Fit | None = None) -> list[Fit]:
        """Fit each hypothesis from its weights, in the executor if there is one. If `around` is given, the
        fits start with the sensitivities of that fit."""
        near = Near(around.hypothesis, around.weights) if around is not None else None
        return fit_all(self.chain, jobs, self.executor, near)

    def fits_here(self, jobs: Sequence[Job]) -> list[Fit]:
        """Fit each hypothesis in this process, while others begin."""
        return fit_all(self.chain, jobs, None)

    def raced(self, jobs: Sequence[Job], now: Fit, heat: int = HEAT) -> list[Fit]:
        """Fit each for a few steps, and to the end only where its outcome against `now` is not yet clear."""
        fits = self.fits([(h, w, min(heat, steps), tolerance) for h, w, steps, tolerance in jobs], now)
        unclear = [k for k, one in enumerate(fits) if self.near(one, now)]
        rest: list[Job] = [(fits[k].hypothesis, fits[k].weights, jobs[k][2], jobs[k][3]) for k in unclear]
        for k, one in zip(unclear, self.fits(rest, now), strict=True):
            fits[k] = one
        return fits

    def near(self, one: Fit, now: Fit) -> bool:
        """Whether a fit that has not converged may still turn out better than `now`."""
        ahead = self.over(now, one)
        return ahead.nats < CLEAR * ahead.sd

    def weigh(self, now: Fit) -> None:
        """Weight every coefficient according to the residual that this fit leaves there, and the noise."""
        self.chain.weighting = Weighting.of(self.chain.records, now.residuals, self.noise)

    def reweighted(self, now: Fit) -> Fit:
        """The fit on a reduced basis of few rows, refitted under the weighting from its own residuals."""
        self.weigh(now)
        small = reduced(self.chain, now)
        (again,) = self.fits([(small.hypothesis, small.weights, 3, ROUGH)])
        return again

    def score(self, one: Fit) -> float:
        """Log predictive density of a fit."""
        return float(self.chain.weighting.log_density(one).sum())

    def worth(self, one: Fit) -> float:
        """Log density with the prior's penalty for each fitted number and each tick of negative alignment: it
        prefers forms with fewer numbers, and no delay that only undoes an early timing."""
        return self.score(one) + PRIOR * (len(one.slots) - min(one.hypothesis.alignment, 0))

    def over(self, better: Fit, worse: Fit, prior: float = 0.0) -> Gain:
        """Difference in log predictive density between two fits."""
        w = self.chain.weighting
        return gain(w.log_density(better), w.log_density(worse), prior, w.strata)

    def prior(self, now: Fit, more: Fit) -> float:
        """Prior log odds of what one hypothesis has in addition to another."""
        new = len(set(more.hypothesis.names)) - len(set(now.hypothesis.names))
        grown = more.hypothesis.nominal.family != now.hypothesis.nominal.family
        return PRIOR * (new + grown)

    def as_well(self, one: Fit, best: Fit) -> bool:
        """Whether a fit predicts as well as a better one within the standard error, so that these recordings
        do not discriminate between the two."""
        ahead = self.over(best, one)
        return not ahead.nats > max(TOGETHER * ahead.sd, -PRIOR)

    def faint(self, more: Fit, less: Fit) -> bool:
        """Whether what a fit explains beyond another is too little to be of use, or to be named."""
        rms_um = self.noise.rms_um if self.noise is not None else more.train_rms
        return explains_less(more, less, FAINT * rms_um)

    def is_noise(self, one: Fit) -> bool:
        """Whether a fit leaves nothing but the noise, if the noise was measured."""
        return self.noise is not None and one.train_rms < float(np.hypot(1.0, FAINT)) * self.noise.rms_um

    def adequate(self, more: Fit, less: Fit) -> bool:
        """Whether a fit explains, beyond another, a large enough share of what is to be explained where it
        acts: any effect explains a little of something that it only resembles."""
        return self.chain.weighting.explained_where_it_acts(more, less) > ADEQUATE

    def inside(self, one: Fit, now: Fit) -> bool:
        """Whether a fit is admissible: no number newly ended on a bound, the command reaches every limit, and
        no spectral line of an effect is one of the command. If the fit has effects beyond `now`, only these
        are checked."""
        members = one.hypothesis.members
        there = {member.kind for member in now.hypothesis.members}
        new = {k for k, member in enumerate(members) if member.kind not in there}
        # How an addition changes a number that was there before is for the backward step to judge.
        bounded = [slot.name for slot in one.on_a_bound if not new or slot.member in {-1, *new}]
        added = [member for k, member in enumerate(members) if not new or k in new]
        return (
            set(bounded) <= set(now.bounded)
            and self.within_reach(added)
            and not any(self.follows_command(member) for member in added)
        )

    def follows_command(self, member: EffectTerm) -> bool:
        """Whether an effect has a spectral line, and has it only in recordings whose command has it too."""
        line_hz = member.effect.line_hz(member.shared)
        if line_hz is None:
            return False
        power = [sum(size**2 for size in own.values()) for own in member.own]
        power = power or [1.0] * len(self.repeating)  # no amplitudes per recording: take them as equal
        return follows_command(line_hz, power, self.repeating)

    def within_reach(self, members: Sequence[EffectTerm]) -> bool:
        """Whether the recordings show each added effect among these: the command exceeds its limit, and of
        several modes one is well below half of the sample rate."""
        added = [member for member in members if member.effect.name not in self.given]
        reached = {m.effect.name for m in added if m.effect.reached(m.shared, self.seen)}
        return reached == {m.effect.name for m in added}

    def needs_no_history(self, now: Fit, less: Fit) -> bool:
        """Whether the recordings are predicted as well, or almost as well, from a de-energised start.

        A history acts only where a recording begins, so the scatter over the cells says nothing about it.
        The prior odds of a history are, for each recording, those of an effect.
        """
        prior = PRIOR * len(self.chain.records)
        return explains_less(now, less, FAINT * less.train_rms) or self.over(now, less, prior).nats < 0


def explains_less(more: Fit, less: Fit, rms_um: float) -> bool:
    """Whether what a fit explains beyond another has an rms below `rms_um`."""
    return less.train_rms**2 - more.train_rms**2 < rms_um**2


def nearly_all(rival: Fit, less: Fit, final: Fit, but: float) -> bool:
    """Whether a rival explains all that an effect explains, except a share that another law of the rival
    might."""
    left = rival.train_rms**2 - final.train_rms**2
    return left < but * (less.train_rms**2 - final.train_rms**2)
