"""Growth of the hysteresis: plays through output functions, a Bouc–Wen state, a bank of Duhem states.

It is a candidate among the effects, and has to beat the present hysteresis with the weights of cells that it
shows itself.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from torchpi.diagnosis.contest import ACCEPTED, ADEQUATE, FAINT, HEAT, PRIOR, STEPS, Tried, explains_less
from torchpi.diagnosis.exchange import Exchange, rms_of
from torchpi.diagnosis.fit import FINE, ROUGH
from torchpi.diagnosis.hypothesis import Fit, Hypothesis
from torchpi.diagnosis.hysteresis_model import HysteresisModel, many_plays, plain, preisach
from torchpi.diagnosis.outside import Outside
from torchpi.diagnosis.parallel import Job
from torchpi.diagnosis.reduced_basis import MANY, basis, grown, refitted
from torchpi.stage.hysteresis import OF_BOUC_WEN, OF_DUHEM

OPERATOR = "hysteresis_operator: "
"""How a larger hysteresis is called among the explanations, before its family."""
SAMPLES_A_PLAY = 10
"""Shorter recordings than so many samples for each of a hundred plays get ten plays."""
REVERSALS = (0.2, 0.6, 2.0)
"""Of the reach, the voltage in which a state turns round: from the shortest alone, loops that do not close
within the range were missed."""
TO_THE_END = 20
"""Steps in which the numbers of a state are found from far away."""
FOLLOWED, FOLLOWS = 8, 0.97
"""Times that a state is fitted again under its own weights, while it leaves a smaller share of the error."""
REJECTED = 3.0
"""A family of hysteresis that fits this many times worse than another is not tried again."""
REWEIGHTED = 3
"""Times that a fit is made again, at most, each with the weights that the last one shows."""


class Growth(Exchange):
    """Fits on given records, whose hysteresis may grow."""

    simulation: Outside | None
    """What is called for the hysteresis, or recorded; None for plays."""
    nominal: HysteresisModel
    rejected_families: set[str]
    states: list[HysteresisModel]
    """Where a Bouc–Wen state begins: anywhere, then where it ended before."""
    many_rows: tuple[Fit, str, Fit] | None = None
    """A fit, the weights of cells, and the fit on many rows."""

    def plays(self) -> HysteresisModel:
        """As many plays as the samples carry."""
        nominal = many_plays(self.seen)
        samples = sum(record.train.sum() for record in self.chain.records)
        return plain(self.seen) if samples < SAMPLES_A_PLAY * nominal.size else nominal

    def added(self, now: Fit) -> list[str]:
        """The effects that the simulation did not have."""
        return [name for name in dict.fromkeys(now.hypothesis.names) if name not in self.given]

    def larger(self) -> list[HysteresisModel]:
        """What the hysteresis may grow to."""
        found = [preisach(self.seen), *self.states]
        return [self.plays(), *found] if self.simulation else found

    def growth(self, now: Fit, leader: Fit, larger: Sequence[HysteresisModel]) -> list[Tried]:
        """A larger hysteresis in place of the present one, fitted to the end where it may beat a fit.

        What is larger has to beat the present one on the same terms.
        """
        h, found = now.hypothesis, list[tuple[str, Fit]]()
        larger = [one for one in larger if one.family not in {*self.rejected_families, h.nominal.family}]
        jobs: list[Job] = [
            (*grown(self.chain, self.on(h, one), self.of_its_plays(one, now), MANY), 2, ROUGH)
            for one in larger
            if not one.has_states
        ]
        fits = self.raced(jobs, leader)
        if starts := [one for one in larger if one.has_states]:
            fits.append(self.of_states(now, starts))
        for one in fits:
            family = one.hypothesis.nominal.family
            # A correction beside a given simulation takes what the effects leave: it is not weighed anew.
            # What an effect beats by far waits for the next round.
            if self.earns(one, now) and self.near(one, leader) and not self.simulation:
                one = self.at_its_own_weights(one)
            found.append((OPERATOR + family, one))
            if one.train_rms > REJECTED * now.train_rms:
                self.rejected_families.add(family)
        full = now
        if any(self.earns(one, now) for _, one in found):
            full = max(now, self.on_many_rows(now), key=self.score)
        return [Tried(name, one, self.over(one, full, PRIOR)) for name, one in found]

    def earns(self, larger: Fit, now: Fit) -> bool:
        """Whether a larger hysteresis may take the place of the present one."""
        return self.over(larger, now).probability > ACCEPTED and not self.bends_to_all(larger, now)

    def bends_to_all(self, larger: Fit, now: Fit) -> bool:
        """Whether a larger hysteresis, with hundreds of numbers that act everywhere, explains a little of
        everything, which is no hysteresis."""
        return self.chain.weighting.explained_of_all(larger, now) <= ADEQUATE

    def of_its_plays(self, larger: HysteresisModel, now: Fit) -> Fit:
        """A fit with the plays that a larger hysteresis has, each a straight line."""
        if larger.pieces == 1 or np.array_equal(larger.thresholds_v, now.hypothesis.nominal.thresholds_v):
            return now
        (one,) = self.fits([(self.on(now.hypothesis, many_plays(self.seen)), None, 2, ROUGH)])
        return one

    def of_states(self, now: Fit, starts: Sequence[HysteresisModel]) -> Fit:
        """States of one family that are not linear in their numbers, alone, or beside plays where that
        predicts better.

        What the present hysteresis leaves everywhere weighs as if it were noise, and plays take most of what
        a state with wrong numbers lacks: beside them, under those weights, it stays where it began. So it
        begins without any, from each of its starts, and is weighted by what it leaves itself.
        """
        jobs: list[Job] = [(self.on(now.hypothesis, one), None, TO_THE_END, ROUGH) for one in starts]
        begun = min(self.fits(jobs), key=lambda one: (bool(one.bounded), one.train_rms))
        if begun.train_rms > REJECTED * now.train_rms:
            return begun
        best = self.followed(begun)
        nominal = best.hypothesis.nominal
        if nominal.bouc_wen and not best.bounded:
            self.states = [starts[0].with_shape(nominal.shape)]
        shared = self.chain.weighting
        self.weigh(best)
        plays = preisach(self.seen) if nominal.duhem else self.plays()
        nominal = replace(nominal, thresholds_v=plays.thresholds_v, pieces=plays.pieces, reduction=None)
        of_its_plays = self.of_its_plays(nominal, now)
        more, _ = grown(self.chain, replace(best.hypothesis, nominal=nominal), of_its_plays, MANY)
        # Once effects are there, only what keeps up with them is fitted to the end.
        heat = HEAT if self.added(now) else TO_THE_END
        (one,) = self.raced([(more, None, TO_THE_END, ROUGH)], now, heat)
        self.chain.weighting = shared
        enough = self.as_well(best, one) or explains_less(one, best, FAINT * best.train_rms)
        return best if enough else one

    def on(self, h: Hypothesis, nominal: HysteresisModel) -> Hypothesis:
        """A hypothesis on another hysteresis. States that are no plays start anywhere: their history is of
        another kind than one that proved needless."""
        if nominal.duhem:
            return replace(h.on(nominal, OF_DUHEM), remanent=True)
        if nominal.bouc_wen:
            return replace(h.on(nominal, OF_BOUC_WEN, (0.0,) * len(self.chain.records)), remanent=True)
        return h.on(nominal)

    def sized(self, now: Fit) -> Fit:
        """A larger hysteresis as it ends: a state's numbers move along a valley each time that the weighting
        follows them."""
        return self.followed(now) if now.hypothesis.shape else self.at_its_own_weights(now)

    def followed(self, now: Fit) -> Fit:
        """A fit with the weights at which it ends."""
        for _ in range(FOLLOWED):
            before, now = now, self.at_its_own_weights(now)
            if now.train_rms > FOLLOWS * before.train_rms:
                break
        return now

    def at_its_own_weights(self, now: Fit) -> Fit:
        """A fit with the weights that it shows itself, where that predicts better and leaves no more: those
        before it make little of where it improves."""
        shared, best = self.chain.weighting, now
        for _ in range(REWEIGHTED):
            self.weigh(now)
            tolerance = FINE if now.hypothesis.shape else ROUGH
            job: tuple[Hypothesis, np.ndarray | None] = (now.hypothesis, now.weights)
            if now.hypothesis.nominal.pieces > 1:
                # Which combinations of a density can be told apart depends on how much counts as noise.
                job = basis(self.chain, now.hypothesis, now.weights, MANY)
            (now,) = self.fits_here([(*job, 8, tolerance)])
            ahead = shared.log_density(now).sum() > shared.log_density(best).sum()
            if not ahead or now.train_rms > best.train_rms or not self.inside(now, best):
                break
            best = now
        self.chain.weighting = shared
        return best

    def on_many_rows(self, one: Fit) -> Fit:
        """What a larger hysteresis is compared with; the last one is kept, since families come one after
        another."""
        token, kept = self.chain.weighting.token, self.many_rows
        if kept is None or kept[0] is not one or kept[1] != token:
            kept = self.many_rows = one, token, self.at_its_own_weights(refitted(self.chain, one, STEPS))
        return kept[2]

    def no_larger(self, now: Fit) -> Fit:
        """With the hysteresis of the simulation again, where effects make a larger one needless, or have
        driven it to the bounds of its numbers."""
        h = now.hypothesis
        if h.nominal.family == self.nominal.family or not self.added(now):
            return now
        plain = refitted(self.chain, self.fits([(h.on(self.nominal), None, STEPS, ROUGH)])[0])
        plain = self.at_its_own_weights(plain)
        if all(slot.member >= 0 for slot in now.on_a_bound) and not self.as_well(plain, now):
            return now
        self.log(f"  without a larger hysteresis: {rms_of(plain)}")
        self.rejected_families.add(h.nominal.family)
        return plain
