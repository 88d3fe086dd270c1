"""Enlarging the hysteresis: plays through output functions, a Bouc–Wen state, a bank of Duhem states.

A larger hysteresis is one candidate among the effects. It has to beat the present hysteresis, fitted with the
cell weights that follow from its own residual.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from torchpi.diagnosis.contest import ACCEPTED, ADEQUATE, FAINT, HEAT, PRIOR, STEPS, Tried, explains_less
from torchpi.diagnosis.exchange import Exchange, rms_of
from torchpi.diagnosis.fit import FINE, ROUGH
from torchpi.diagnosis.hypothesis import Fit, Hypothesis
from torchpi.diagnosis.hysteresis_model import HysteresisModel, as_given, many_plays, plain, preisach
from torchpi.diagnosis.outside import Outside
from torchpi.diagnosis.parallel import Job
from torchpi.diagnosis.reduced_basis import MANY, basis, grown, refitted
from torchpi.stage.hysteresis import OF_BOUC_WEN, OF_DUHEM, Hysteresis

OPERATOR = "hysteresis_operator: "
"""Prefix, before the family, of the name of a larger hysteresis among the explanations."""
SAMPLES_A_PLAY = 10
"""Fitted samples per play: recordings with fewer for each of a hundred plays get ten plays."""
REVERSALS = (0.2, 0.6, 2.0)
"""Voltages in which a state turns round, as shares of the reach, from which its fit starts: starting from the
shortest alone missed loops that do not close within the range."""
TO_THE_END = 20
"""Number of steps in which the parameters of a state are found from a distant start."""
FOLLOWED, FOLLOWS = 8, 0.97
"""Maximum number of refits of a state under its own weights, and the rms ratio at which all refits stop."""
REJECTED = 3.0
"""A hysteresis family whose rms is this many times that of the present fit is not tried again."""
REWEIGHTED = 3
"""Maximum number of refits, each with the weights that follow from the residual of the last."""


class Growth(Exchange):
    """Fits over the given records with a hysteresis that may be enlarged."""

    simulation: Outside | None
    """The given simulation, called or recorded, in place of plays; None for plays."""
    hysteresis: Hysteresis | None
    """The hysteresis of a given stage; None for another simulation, or none."""
    nominal: HysteresisModel
    rejected_families: set[str]
    states: list[HysteresisModel]
    """Starting points of a Bouc–Wen state: a fixed grid at first, later its last fitted values."""
    many_rows: tuple[Fit, str, Fit] | None = None
    """The last result of `on_many_rows`: a fit, the token of its cell weights, and that fit on many rows."""

    def plays(self) -> HysteresisModel:
        """Return as many plays as the number of samples supports, or the states of the given hysteresis if it
        is more than a weighted sum of plays."""
        given = self.hysteresis
        if given is not None and not given.is_weighted_sum:
            return as_given(self.seen, given)
        nominal = many_plays(self.seen, given)
        samples = sum(record.train.sum() for record in self.chain.records)
        return plain(self.seen, given) if samples < SAMPLES_A_PLAY * nominal.size else nominal

    def preisach(self) -> HysteresisModel:
        """Return the same plays through output functions."""
        return preisach(self.seen, given=self.hysteresis)

    def added(self, now: Fit) -> list[str]:
        """Return the names of the effects that the given simulation lacks."""
        return [name for name in dict.fromkeys(now.hypothesis.names) if name not in self.given]

    def has_larger(self, now: Fit) -> bool:
        """Whether a fit has a larger hysteresis than the retuned simulation."""
        return now.hypothesis.nominal.family != self.nominal.family

    def larger(self) -> list[HysteresisModel]:
        """Return the larger hysteresis models that may replace the present one."""
        found = [self.preisach(), *self.states]
        return [self.plays(), *found] if self.simulation else found

    def growth(self, now: Fit, leader: Fit, larger: Sequence[HysteresisModel]) -> list[Tried]:
        """Fit each larger hysteresis in place of the present one, to convergence where it may beat `leader`;
        none where only noise is left, which no hysteresis explains.

        States are tried only where plays through output functions, which imitate any hysteresis on given
        motions, may beat `leader` too. For a fair comparison, the present hysteresis is refitted in the same
        way.
        """
        if self.is_noise(now):
            return []
        h, found = now.hypothesis, list[tuple[str, Fit]]()
        larger = [one for one in larger if one.family not in {*self.rejected_families, h.nominal.family}]
        jobs: list[Job] = [
            (*grown(self.chain, self.on(h, one), self.of_its_plays(one, now), MANY), 2, ROUGH)
            for one in larger
            if not one.has_states
        ]
        fits = self.raced(jobs, leader)
        promising = not fits or any(self.near(one, leader) for one in fits)
        if promising and (starts := [one for one in larger if one.has_states]):
            fits.append(self.of_states(now, starts))
        for one in fits:
            family = one.hypothesis.nominal.family
            # A correction beside a given simulation only absorbs what the effects leave: no reweighting.
            # A family that another candidate beats by far waits for the next round.
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
        """Whether a larger hysteresis may replace the present one."""
        return self.over(larger, now).probability > ACCEPTED and not self.bends_to_all(larger, now)

    def bends_to_all(self, larger: Fit, now: Fit) -> bool:
        """Whether a larger hysteresis only explains a little of everything, its hundreds of parameters acting
        everywhere: that is no hysteresis."""
        return self.chain.weighting.explained_of_all(larger, now) <= ADEQUATE

    def of_its_plays(self, larger: HysteresisModel, now: Fit) -> Fit:
        """Return a fit with the plays of a larger hysteresis, each with a linear output function."""
        if larger.pieces == 1 or np.array_equal(larger.thresholds_v, now.hypothesis.nominal.thresholds_v):
            return now
        plays = many_plays(self.seen, self.hysteresis)
        (one,) = self.fits([(self.on(now.hypothesis, plays), None, 2, ROUGH)])
        return one

    def of_states(self, now: Fit, starts: Sequence[HysteresisModel]) -> Fit:
        """Fit states of one family that are nonlinear in their parameters: alone, or beside plays where that
        predicts better.

        The present weights treat the residual of the present hysteresis as noise, and plays absorb most of
        what a state with wrong parameters lacks, so beside plays a state would stay at its start. It is
        therefore fitted without plays first, from each start, and then weighted by its own residual.
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
        plays = self.preisach() if nominal.duhem else self.plays()
        nominal = replace(nominal, thresholds_v=plays.thresholds_v, pieces=plays.pieces, reduction=None)
        of_its_plays = self.of_its_plays(nominal, now)
        more, _ = grown(self.chain, replace(best.hypothesis, nominal=nominal), of_its_plays, MANY)
        # Once effects have been added, only a fit that keeps up with them is continued to convergence.
        heat = HEAT if self.added(now) else TO_THE_END
        (one,) = self.raced([(more, None, TO_THE_END, ROUGH)], now, heat)
        self.chain.weighting = shared
        enough = self.as_well(best, one) or explains_less(one, best, FAINT * best.train_rms)
        return best if enough else one

    def on(self, h: Hypothesis, nominal: HysteresisModel) -> Hypothesis:
        """Put a hypothesis on another hysteresis. Bouc–Wen and Duhem states start from an unknown history,
        even where that of plays proved unnecessary: theirs is of another kind."""
        if nominal.duhem:
            return replace(h.on(nominal, OF_DUHEM), remanent=True)
        if nominal.bouc_wen:
            return replace(h.on(nominal, OF_BOUC_WEN, (0.0,) * len(self.chain.records)), remanent=True)
        return h.on(nominal)

    def sized(self, now: Fit) -> Fit:
        """Refit a larger hysteresis under its own weights, repeatedly if it has states: their parameters move
        along a valley of the cost each time the weights are updated."""
        return self.followed(now) if now.hypothesis.shape else self.at_its_own_weights(now)

    def followed(self, now: Fit) -> Fit:
        """Refit, and update the weights from each fit, until the residual hardly decreases."""
        for _ in range(FOLLOWED):
            before, now = now, self.at_its_own_weights(now)
            if now.train_rms > FOLLOWS * before.train_rms:
                break
        return now

    def at_its_own_weights(self, now: Fit) -> Fit:
        """Refit under the weights that follow from the fit's own residual, while that decreases and the fit
        predicts better. Weights from an earlier fit give little credit where this one improves."""
        shared, best = self.chain.weighting, now
        for _ in range(REWEIGHTED):
            self.weigh(now)
            tolerance = FINE if now.hypothesis.shape else ROUGH
            job: tuple[Hypothesis, np.ndarray | None] = (now.hypothesis, now.weights)
            if now.hypothesis.nominal.pieces > 1:
                # Which combinations of a density can be distinguished depends on how much counts as noise.
                job = basis(self.chain, now.hypothesis, now.weights, MANY)
            (now,) = self.fits_here([(*job, 8, tolerance)])
            ahead = shared.log_density(now).sum() > shared.log_density(best).sum()
            if not ahead or now.train_rms > best.train_rms or not self.inside(now, best):
                break
            hardly, best = now.train_rms > FOLLOWS * best.train_rms, now
            if hardly and not now.hypothesis.shape:  # the parameters of states move along a valley
                break
        self.chain.weighting = shared
        return best

    def on_many_rows(self, one: Fit) -> Fit:
        """Refit on many rows, for the comparison with a larger hysteresis. The last result is cached, since
        the families are tried one after another."""
        token, kept = self.chain.weighting.token, self.many_rows
        if kept is None or kept[0] is not one or kept[1] != token:
            kept = self.many_rows = one, token, self.at_its_own_weights(refitted(self.chain, one, STEPS))
        return kept[2]

    def no_larger(self, now: Fit) -> Fit:
        """Return to the hysteresis of the simulation where effects have made a larger one redundant, or have
        driven its parameters to their bounds."""
        h = now.hypothesis
        if not self.has_larger(now) or not self.added(now):
            return now
        plain = refitted(self.chain, self.fits([(h.on(self.nominal), None, STEPS, ROUGH)])[0])
        plain = self.at_its_own_weights(plain)
        if all(slot.member >= 0 for slot in now.on_a_bound) and not self.as_well(plain, now):
            return now
        self.log(f"  without a larger hysteresis: {rms_of(plain)}")
        self.rejected_families.add(h.nominal.family)
        return plain
