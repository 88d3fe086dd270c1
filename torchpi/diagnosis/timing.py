"""Timing: conventions of whole ticks, which depend on who recorded, and the delays that rival them."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np
import torch

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.contest import ACCEPTED, Contest
from torchpi.diagnosis.fit import ROUGH
from torchpi.diagnosis.hypothesis import EffectTerm, Fit, Hypothesis
from torchpi.diagnosis.noise import Noise
from torchpi.diagnosis.parallel import Job
from torchpi.diagnosis.reduced_basis import reduced
from torchpi.stage.effects.effect import LinearEffect

RAMP = 20_000
"""Samples of a ramp, after which a delayed output follows it at a constant distance."""
TIMED = 12
"""Maximum number of Gauss–Newton steps of a fit with another timing."""
WHOLE = 0.05
"""Fraction of a tick: a lateness this close to a whole number of ticks is a convention."""


class Timing(Contest):
    """Fits on given records, under alternative conventions of timing.

    Args:
        chain: The recordings, and the weight of each coefficient.
        noise: The measured noise, if any.
        executor: Where independent fits run; None for this process.
        alignments: The conventions, in ticks by which y(k) lags the command of its own tick.
        given: The names of the effects that the simulation already has.
    """

    def __init__(
        self,
        chain: Chain,
        noise: Noise | None,
        executor: Executor | None,
        alignments: Sequence[int],
        given: set[str],
    ) -> None:
        super().__init__(chain, noise, executor, given)
        self.alignments = alignments
        self.starts: list[EffectTerm] = []
        """The starts from which effects are fitted."""

    def at_the_tick(self, now: Fit) -> Fit:
        """Return the fit at alignment 0 if an added effect delays and predicts as well with that timing."""
        h = now.hypothesis
        if h.alignment == 0 or not any(
            m.effect.delays and m.effect.name not in self.given for m in h.members
        ):
            return now
        (other,) = self.fits_here([(replace(h, alignment=0), now.weights, TIMED, ROUGH)])
        return other if self.as_well(other, now) and self.inside(other, now) else now

    def realigned(self, now: Fit) -> Fit:
        """Choose the timing conventions and the initial state that predict best: neither is physics."""
        small = reduced(self.chain, now)
        remembers = small.hypothesis.remanent
        (other,) = self.fits([(replace(small.hypothesis, remanent=not remembers), None, TIMED, ROUGH)])
        more, less = (small, other) if remembers else (other, small)
        # What an effect now explains may have been mistaken for a history before, or may have hidden one.
        best = less if self.needs_no_history(more, less) else more
        # A delay of whole ticks may be the convention itself.
        late = [m.effect.name for m in now.hypothesis.members if m.effect.commutes]
        others = [
            replace(h, alignment=alignment, held=held)
            for h in (best.hypothesis, *(best.hypothesis.without(name) for name in late))
            for alignment in self.alignments
            for held in (False, True)
            if (alignment, held) != (now.hypothesis.alignment, now.hypothesis.held)
        ]
        raced = self.raced([(h, best.weights, 3, ROUGH) for h in others], best)
        return max([best, *(one for one in raced if not one.bounded)], key=self.worth)

    def as_a_lag_and_a_delay(self, h: Hypothesis) -> list[Hypothesis]:
        """Replace all added effects that delay by a one-number lag and a delay of the same total lateness.
        From two lags, or a lag with more numbers, no exchange of single effects leads there."""
        late = [m for m in h.members if m.effect.delays and m.effect.name not in self.given]
        starts = [m for m in self.starts if m.effect.delays and issubclass(m.effect, LinearEffect)]
        pure = {m.effect for m in starts if m.effect.commutes} - {m.effect for m in late}
        if not pure or max([len(late), *(len(m.shared) for m in late)]) < 2:
            return []
        bare, in_all_s = h, lateness_s(self.chain, h)
        for member in late:
            bare = bare.without(member.effect.name)
        found = []
        for start in (m for m in starts if not m.effect.commutes and len(m.shared) == 1):
            for alignment in self.alignments:
                one = replace(bare.plus(start), alignment=alignment)
                rest_s = in_all_s - lateness_s(self.chain, one)
                if rest_s > 0:
                    found += [one.plus(EffectTerm(each, each.later({}, rest_s) or {})) for each in pure]
        return found

    def delayed(self, now: Fit) -> Fit:
        """Replace a timing convention by a delay, if that is clearly better and the total lateness is not a
        whole number of ticks."""
        h = now.hypothesis
        if h.alignment - 1 not in self.alignments:
            return now
        tick_s = float(np.median([record.tick_s for record in self.chain.records]))
        there = {member.effect: member.shared for member in h.members}
        jobs: list[Job] = []
        for effect, member in {member.effect: member for member in self.starts}.items():
            if later := effect.later(there.get(effect, {}), tick_s):
                one = h.without(effect.name).plus(replace(member, shared=later))
                jobs.append((replace(one, alignment=h.alignment - 1), now.weights, TIMED, ROUGH))
        fits = [
            one for one in self.raced(jobs, now) if self.inside(one, now) and not is_whole(self.chain, one)
        ]
        clear = [one for one in fits if self.over(one, now, self.prior(now, one)).probability > ACCEPTED]
        return max([now, *clear], key=self.worth)


def is_whole(chain: Chain, one: Fit) -> bool:
    """Whether the readings lag the command by whole ticks, with no effect that also smooths it."""
    smooths = any(m.effect.delays and not m.effect.commutes for m in one.hypothesis.members)
    late = lateness_s(chain, one.hypothesis) / chain.records[0].tick_s
    return not smooths and abs(late - round(late)) < WHOLE


def lateness_s(chain: Chain, h: Hypothesis) -> float:
    """Return how far the readings lag a slow command, s: the sum of all delays in a hypothesis."""
    record = chain.records[0]
    slope = 1e-6 * chain.span_v  # per sample: below any rate limit
    ramp = slope * torch.arange(RAMP, dtype=torch.float64)[None]
    with torch.no_grad():
        behind = [float((ramp - p(ramp))[0, -1]) for p in chain.arranged(h, 0).effects if p.effect.delays]
    return sum(behind) / slope * record.period_s + h.alignment * record.tick_s
