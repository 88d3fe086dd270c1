"""Forward search: the hysteresis first, then one effect after another, everything refitted each time.

Enlarging the hysteresis model is one candidate among the others: if it explains the residual as well as an
effect does, the data are no evidence for that effect, and vice versa. One score decides throughout
(`torchpi.diagnosis.score`); which effects are named, and how surely, is decided afterwards (`posterior`).
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.contest import ACCEPTED, STEPS, Tried, explains_less
from torchpi.diagnosis.coverage import reason_to_leave_out
from torchpi.diagnosis.exchange import effects_of, rms_of
from torchpi.diagnosis.fit import FINE, ROUGH
from torchpi.diagnosis.growth import OPERATOR, REVERSALS
from torchpi.diagnosis.hypothesis import EffectTerm, Fit, Hypothesis
from torchpi.diagnosis.hysteresis_model import HysteresisModel, bouc_wen, duhem
from torchpi.diagnosis.noise import Noise, noise_of_prediction
from torchpi.diagnosis.outside import Outside
from torchpi.diagnosis.parallel import screen_all
from torchpi.diagnosis.proposals import STARTS, Proposals
from torchpi.diagnosis.records import without_start
from torchpi.diagnosis.reduced_basis import MANY, basis, refitted
from torchpi.diagnosis.screen import candidates_of
from torchpi.diagnosis.start_up import unsettled
from torchpi.diagnosis.stick_slip import Jump, Slips, jump, slips
from torchpi.stage.effects import EFFECTS
from torchpi.stage.effects.effect import Described, Effect
from torchpi.stage.effects.inside import InsideEffect
from torchpi.stage.effects.mechanics.stiction import Stiction
from torchpi.stage.hysteresis import Hysteresis

ROUNDS = 7


@dataclass(frozen=True, eq=False)
class Round:
    """The candidates fitted on top of one hypothesis, the best first."""

    before: Fit
    tried: tuple[Tried, ...]
    accepted: str | None
    """Name of the accepted candidate; None if none was accepted."""


class Search(Proposals):
    """Forward search over the given records."""

    def __init__(
        self,
        chain: Chain,
        log: Callable[[str], None],
        given: Sequence[EffectTerm] = (),
        noise: Noise | None = None,
        executor: Executor | None = None,
        lsb_um: float = 0.0,
        effects: Sequence[type[Effect] | type[InsideEffect]] = EFFECTS,
        simulation: Outside | None = None,
        hysteresis: Hysteresis | None = None,
    ) -> None:
        alignments = simulation.alignments if simulation else (0, 1)
        super().__init__(chain, noise, executor, alignments, {member.effect.name for member in given})
        self.log, self.start, self.lsb_um = log, tuple(given), lsb_um
        self.simulation, self.hysteresis = simulation, hysteresis
        self.seen = replace(self.seen, simulated=simulation is not None)
        self.nominal = HysteresisModel(np.zeros(0))
        self.rejected_families = set()
        self.states = [bouc_wen(self.seen, share) for share in REVERSALS]
        self.left_out = []
        self.needless = set()
        self.unsettled = (0,) * len(chain.records)
        """For each recording, how many of its first readings were found not to count."""
        self.brought_back = 0.0
        """Largest share of the next step that was taken out of a reading, because its time stamp is late."""
        self.slips: Slips | None = None
        self.jump: Jump | None = None
        """Jump of the final fit, where a mount sticks."""
        self.effects_tried = []
        for effect in effects:
            if effect.read_off:
                continue
            starts = candidates_of(effect, chain.records, effect.starts(self.seen), list(self.seen.aux))
            if why := reason_to_leave_out(effect, chain.records, self.seen, len(starts)):
                self.left_out.append((effect.name, why))
            else:
                self.effects_tried.append(effect)
                self.starts += starts

    def run(self) -> tuple[Fit, Fit, list[Round]]:
        """Search forward with a backward check; return the retuned nominal, the best fit and the rounds."""
        retuned = now = self.retuned()
        self.nominal = retuned.hypothesis.nominal
        history: list[Round] = []
        for number in range(1, ROUNDS + 1):
            if stuck := self.sticking(now):
                before, found = stuck
                history.append(Round(before, (found,), found.name))
                retuned = before if now is retuned else retuned
                now = found.fit
            retuned, now = self.from_settled(retuned, now)
            self.noise = self.noise_left(now)
            small = self.reweighted(now)
            tried = self.round(small)
            best = f"; best {tried[0].name}, {describe(tried[0])}" if tried else ""
            self.log(f"round {number}: {len(tried)} explanations fitted{best}")
            chosen = self.simplest(tried, small)
            late = self.delayed(now) if chosen is None else now
            if late is not now:
                history.append(Round(now, tuple(tried), None))
                now = self.backward(self.swapped(late))
                self.log(f"  with {effects_of(now)} in place of a timing convention: {rms_of(now)}")
                continue
            if chosen is None or is_slow(chosen) or (is_larger(chosen) and not self.is_noise(chosen.fit)):
                # Duhem states lack the wiping-out property and can imitate other physics, so they are tried
                # last. Their loops drift until they close, which looks like a slow effect.
                last = self.growth(small, small, [duhem(self.seen)])
                last = [one for one in last if self.inside(one.fit, small)]
                if chosen and is_larger(chosen):
                    last = [one for one in last if not self.bends_to_all(one.fit, chosen.fit)]
                    tried = sorted([*tried, *last], key=lambda one: -one.gain.nats)
                else:
                    tried += last
                chosen = self.simplest(tried, small)
            history.append(Round(now, tuple(tried), chosen.name if chosen else None))
            if chosen is None:
                break
            grown = self.sized(chosen.fit) if is_larger(chosen) else self.at_its_own_weights(chosen.fit)
            # An addition that explains less than the noise is no reason to revise earlier choices.
            considerable = self.noise is None or not explains_less(grown, small, self.noise.rms_um)
            now = self.backward(self.swapped(self.realigned(grown)) if considerable else grown)
            self.needless |= set(chosen.fit.hypothesis.names) - set(now.hypothesis.names)
            self.log(f"  with {effects_of(now) or chosen.name}: {rms_of(now)}")
        self.weigh(now)
        if self.slips:
            self.jump = jump(self.slips, now)
        else:
            now = self.without_history(self.on_its_rows(self.at_the_tick(now)))
        return retuned, now, history

    def on_its_rows(self, now: Fit) -> Fit:
        """Return the fit on many rows, if it predicts as well. There the prior acts on the whole hysteresis,
        not only on what was added last, and may distort a stage whose travel is many times the noise."""
        again = refitted(self.chain, now)
        return again if self.as_well(again, now) else now

    def without_history(self, now: Fit) -> Fit:
        """Return the fit with recordings that start de-energised, if it predicts as well. A history can stand
        in for the first loading curve, which many rows describe and few rows do not."""
        if not now.hypothesis.remanent:
            return now
        h, _ = basis(self.chain, replace(now.hypothesis, remanent=False), None, MANY)
        (less,) = self.fits_here([(h, None, STEPS, FINE)])
        if not self.needs_no_history(now, less):
            return now
        self.log(f"  from the de-energised state: {rms_of(less)}")
        return less

    def simplest(self, tried: Sequence[Tried], now: Fit) -> Tried | None:
        """Return the best acceptable candidate, or a rival that stands as well.

        An effect takes the place of a larger hysteresis that predicts no better, or explains only a little of
        everything beyond the effect. A larger hysteresis that predicts as well takes the place of an effect
        that is slow or itself a hysteresis, because a play behind plays is again plays.
        """
        earned = [
            one
            for one in tried
            if one.gain.probability > ACCEPTED
            and not self.faint(one.fit, now)
            and self.adequate(one.fit, now)
            and not (is_larger(one) and self.bends_to_all(one.fit, now))
        ]
        if not earned:
            return None
        larger = [one for one in earned if is_larger(one)]
        effects = [one for one in earned if one not in larger]
        best = earned[0]
        if best in larger:
            rivals = [one for one in effects if not sticks(one)]
        elif sticks(best) or is_slow(best):
            rivals = larger
        else:
            return best
        # A larger hysteresis is fitted on many rows, so its best rivals are too, before the comparison.
        known = best.fit if best in larger else self.on_many_rows(best.fit)
        for one in rivals[:2]:
            full = self.on_many_rows(one.fit)
            # It would absorb part of what is still missing, such as a lag, and bar the effect from then on.
            bends = best in larger and self.bends_to_all(known, full)
            if bends or self.as_well(full, known):
                return replace(one, fit=full)
        return best

    def retuned(self) -> Fit:
        """Fit the nominal hysteresis, with the timing convention and initial state that predict better."""
        alone = HysteresisModel(np.zeros(0), simulation=self.simulation)
        nominal = alone if self.simulation else self.plays()
        # A given simulation is first taken as it is: only the weights are solved for.
        begun = self.on(Hypothesis(nominal, self.start, remanent=True), nominal)
        h, _ = basis(self.chain, begun, None, MANY)
        each = [replace(h, alignment=a) for a in self.alignments]
        as_it_is = max(self.fits_here([(one, None, 0, FINE) for one in each]), key=self.score)
        now = self.converged(as_it_is)
        moved = self.with_given_modes_moved(now, as_it_is.hypothesis)
        now = now if moved is now else self.converged(moved)
        if not nominal.has_states:
            (less,) = self.fits_here([(replace(now.hypothesis, remanent=False), None, 8, FINE)])
            now = less if self.needs_no_history(now, less) else now
        if self.noise is not None:
            # The noise of a monitored voltage appears in the simulated response to a hold.
            self.noise = self.noise_in(now) or self.noise
        self.weigh(now)
        size = "gain and offset" if self.simulation else f"{len(nominal.thresholds_v)} plays"
        self.log(f"retuned, {size}: {rms_of(now)}")
        return now

    def converged(self, now: Fit) -> Fit:
        """Refit a few times on many rows, each with the weighting that follows from the last fit, and under
        the timing convention that predicts better."""
        for tolerance in (ROUGH, ROUGH, FINE):
            self.weigh(now)
            h, _ = basis(self.chain, now.hypothesis, None, MANY)
            others = [replace(h, alignment=a) for a in self.alignments if a != h.alignment]
            now = max(self.fits_here([(one, None, 8, tolerance) for one in (h, *others)]), key=self.score)
        return now

    def with_given_modes_moved(self, now: Fit, given: Hypothesis) -> Fit:
        """Return the fit with each given mode where the recordings show one, if that predicts better.
        No step leads across several widths of a mode, but other numbers may have moved in its place."""
        for member in now.hypothesis.members:
            kinds = [effect for effect in self.effects_tried if effect is member.effect]
            if not kinds or not member.effect.rings:
                continue
            self.weigh(now)
            less = now.hypothesis.without(member.effect.name)
            (bare,) = self.fits_here([(less, None, 0, ROUGH)])
            self.weigh(bare)  # the residual of a mode at the wrong frequency hides the right one
            starts = [one for one in self.starts if one.effect is member.effect]
            starts += self.from_residual(bare, kinds)
            (screened,) = screen_all(self.chain, [(bare, starts)], self.executor)
            rescaled, at_once = (sorted(screened, key=attrgetter(one)) for one in ("gain", "at_once"))
            best = rescaled[-STARTS:]
            best += [one for one in at_once[-STARTS:] if one not in best]
            still = given.without(member.effect.name)
            moved = self.fits([(still.plus(c.member), None, STEPS, ROUGH) for c in best])
            ahead = max(moved, key=self.score, default=now)
            if self.over(ahead, now).probability > ACCEPTED and not self.faint(ahead, now):
                self.log(f"the simulation's {member.effect.name} moved: {rms_of(ahead)}")
                now, given = ahead, ahead.hypothesis
            self.weigh(now)
        return now

    def noise_left(self, now: Fit) -> Noise | None:
        """Return the noise that a fit leaves: hum, drift or another axis seen in a hold is not noise once it
        has been explained."""
        if self.noise is None or self.slips:
            return self.noise
        left = self.noise_in(now)
        return left if left and left.rms_um < self.noise.rms_um else self.noise

    def noise_in(self, now: Fit) -> Noise | None:
        """Return the noise estimated from the residuals of a fit."""
        chain = self.chain
        return noise_of_prediction(chain.records, self.lsb_um, chain.gain_um_per_v, now.residuals)

    def from_settled(self, retuned: Fit, now: Fit) -> tuple[Fit, Fit]:
        """Refit both without the first readings, in which the stage still settles, if `now` shows any."""
        found = unsettled(self.chain.records, now.residuals)
        if self.slips or not any(found):
            return retuned, now
        self.unsettled = tuple(map(max, self.unsettled, found))
        self.chain = Chain(without_start(self.chain.records, found))
        both = []
        for one in (retuned, now):
            self.weigh(one)
            both += self.fits_here([(one.hypothesis, one.weights, 8, ROUGH)])
        self.log(f"without a start that has not settled: {rms_of(both[1])}")
        return both[0], both[1]

    def sticking(self, now: Fit) -> tuple[Fit, Tried] | None:
        """Return the fit without a history, and stiction on top of it, if the readings show stiction. From
        then on everything is fitted to the samples at which the mount slips."""
        if Stiction.name in now.hypothesis.names or self.noise is None:
            return None
        if now.hypothesis.remanent:  # a mount that has not slipped yet looks like a history
            (now,) = self.fits([(replace(now.hypothesis, remanent=False), None, 8, FINE)])
        found = slips(self.chain, now, self.noise.rms_um, self.lsb_um)
        if found is None:
            return None
        self.chain, self.slips = found.chain, found
        self.log(f"the readings hold and jump, so the mount sticks: one step ahead {rms_of(found.fit)}")
        return now, Tried(Stiction.name, found.fit, self.over(found.fit, now))

    def round(self, now: Fit) -> list[Tried]:
        """Fit every promising effect and every larger hysteresis on top of this fit; the best comes first."""
        fits = self.effects(now)
        leader = max([now, *(one for _, one in fits)], key=self.score)
        tried = [Tried(name, one, self.over(one, now, self.prior(now, one))) for name, one in fits]
        tried += self.growth(now, leader, self.larger())
        return sorted([t for t in tried if self.inside(t.fit, now)], key=lambda t: -t.gain.nats)

    def backward(self, now: Fit) -> Fit:
        """Remove effects that have become redundant given the others, or given a larger hysteresis."""
        while len(parts := self.parts(now)) > (0 if self.has_larger(now) else 1):
            small = self.reweighted(now)
            fits = self.without_each(small, parts)
            gains = [self.over(small, less, self.prior(less, small)) for less in fits]
            worst = int(np.argmin([one.nats for one in gains]))
            if gains[worst].probability > 0.5:
                break
            self.log(f"  without {' of '.join(filter(None, parts[worst]))}: the others explain it")
            now = fits[worst]
        return self.no_larger(now)

    def without_each(self, now: Fit, parts: Sequence[tuple[str, str]]) -> list[Fit]:
        """Return, for each part of a fit, the fit without it."""
        return self.raced([(now.hypothesis.without(*p), now.weights, STEPS, ROUGH) for p in parts], now)

    def parts(self, now: Fit) -> list[tuple[str, str]]:
        """Return the added effects as names and signals, with each auxiliary signal separate."""
        members = now.hypothesis.members
        return list(dict.fromkeys((m.effect.name, m.aux) for m in members if m.effect.name not in self.given))


def is_larger(one: Tried) -> bool:
    """Whether a candidate is a larger hysteresis."""
    return one.name.startswith(OPERATOR)


def describe(one: Tried) -> str:
    return f"{one.gain.nats:.0f} ± {one.gain.sd:.0f} nats, {rms_of(one.fit)}"


def sticks(one: Tried) -> bool:
    """Whether a candidate contains an effect that is itself a hysteresis."""
    return any(effect.sticks for effect in effects_in(one))


def is_slow(one: Tried) -> bool:
    """Whether a candidate contains an effect that acts over seconds or longer."""
    return any(effect.time_scale == "slow" for effect in effects_in(one))


def effects_in(one: Tried) -> list[type[Described]]:
    """Return the effects in the name of a candidate; none for a larger hysteresis."""
    there = {member.effect.name: member.effect for member in one.fit.hypothesis.members}
    return [there[name] for name in one.name.split(" + ") if name in there]
