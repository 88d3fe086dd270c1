"""Search: the hysteresis first, then one effect after another, everything refitted each time.

Growth of the hysteresis is a candidate among the others: what a larger hysteresis explains as well as an
effect does is not evidence of that effect, and the other way round. One score decides throughout
(`torchpi.diagnosis.score`); what is named, and how sure that is, is decided afterwards (`posterior`).
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.contest import ACCEPTED, STEPS, Tried, explains_less
from torchpi.diagnosis.coverage import reason_to_leave_out
from torchpi.diagnosis.exchange import rms_of
from torchpi.diagnosis.fit import FINE, ROUGH
from torchpi.diagnosis.growth import OPERATOR, REVERSALS
from torchpi.diagnosis.hypothesis import EffectTerm, Fit, Hypothesis
from torchpi.diagnosis.hysteresis_model import HysteresisModel, bouc_wen, duhem
from torchpi.diagnosis.noise import Noise, noise_of_prediction
from torchpi.diagnosis.outside import Outside
from torchpi.diagnosis.proposals import Proposals
from torchpi.diagnosis.records import without_start
from torchpi.diagnosis.reduced_basis import MANY, basis, refitted
from torchpi.diagnosis.screen import candidates_of
from torchpi.diagnosis.start_up import unsettled
from torchpi.diagnosis.stick_slip import Jump, Slips, jump, slips
from torchpi.stage.effects import EFFECTS
from torchpi.stage.effects.effect import Described, Effect
from torchpi.stage.effects.inside import InsideEffect
from torchpi.stage.effects.mechanics.stiction import Stiction

ROUNDS = 7


@dataclass(frozen=True, eq=False)
class Round:
    """What was tried on top of one hypothesis, the best first."""

    before: Fit
    tried: tuple[Tried, ...]
    accepted: str | None
    """The name of what was taken."""


class Search(Proposals):
    """A search on given records."""

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
    ) -> None:
        alignments = simulation.alignments if simulation else (0, 1)
        super().__init__(chain, noise, executor, alignments, {member.effect.name for member in given})
        self.log, self.start, self.lsb_um = log, tuple(given), lsb_um
        self.simulation = simulation
        self.seen = replace(self.seen, simulated=simulation is not None)
        self.nominal = HysteresisModel(np.zeros(0))
        self.rejected_families = set()
        self.states = [bouc_wen(self.seen, share) for share in REVERSALS]
        self.left_out = []
        self.needless = set()
        self.unsettled = (0,) * len(chain.records)
        """Of each recording, the first readings that were found not to count."""
        self.slips: Slips | None = None
        self.jump: Jump | None = None
        """Of the final fit, where a mount sticks."""
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
        """The retuned nominal, the best hypothesis, and the rounds: forward, with a backward check."""
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
                self.log(f"  with {', '.join(now.hypothesis.names)}, and no other timing: {rms_of(now)}")
                continue
            if chosen is None or is_slow(chosen) or (is_larger(chosen) and not self.is_noise(chosen.fit)):
                # What has no wiping-out can do much that is physics of another kind: it comes last. Its loops
                # drift to where they close, which looks slow.
                last = self.growth(small, small, [duhem(self.seen)])
                last += self.walks(small) if chosen is None else []
                if chosen and is_larger(chosen):
                    last = [one for one in last if not self.bends_to_all(one.fit, chosen.fit)]
                tried += [one for one in last if self.inside(one.fit, small)]
                if chosen and is_larger(chosen):
                    tried.sort(key=lambda one: -one.gain.nats)
                chosen = self.simplest(tried, small)
            history.append(Round(now, tuple(tried), chosen.name if chosen else None))
            if chosen is None:
                break
            grown = self.sized(chosen.fit) if is_larger(chosen) else self.at_its_own_weights(chosen.fit)
            # What explains less than the noise changes nothing of what was taken before.
            considerable = self.noise is None or not explains_less(grown, small, self.noise.rms_um)
            now = self.backward(self.swapped(self.realigned(grown)) if considerable else grown)
            self.needless |= set(chosen.fit.hypothesis.names) - set(now.hypothesis.names)
            self.log(f"  with {', '.join(now.hypothesis.names) or chosen.name}: {rms_of(now)}")
        self.weigh(now)
        if self.slips:
            self.jump = jump(self.slips, now)
        else:
            now = self.without_history(self.on_its_rows(self.at_the_tick(now)))
        return retuned, now, history

    def on_its_rows(self, now: Fit) -> Fit:
        """The fit on many rows, where that predicts as well: there the prior holds all of a hysteresis, not
        only what was added to it last, and may bend a stage whose travel is many times the noise."""
        again = refitted(self.chain, now)
        return again if self.as_well(again, now) else now

    def without_history(self, now: Fit) -> Fit:
        """The fit to recordings that start de-energised, where that predicts as well: a history takes the
        place of the first loading curve, which many rows know and few do not."""
        if not now.hypothesis.remanent:
            return now
        h, _ = basis(self.chain, replace(now.hypothesis, remanent=False), None, MANY)
        (less,) = self.fits_here([(h, None, STEPS, FINE)])
        if not self.needs_no_history(now, less):
            return now
        self.log(f"  from the de-energised state: {rms_of(less)}")
        return less

    def simplest(self, tried: Sequence[Tried], now: Fit) -> Tried | None:
        """The best of what earns its place. An effect where a larger hysteresis is no clearer; the larger
        hysteresis where the effect is one itself: a play behind plays is plays."""
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
        # A larger hysteresis is fitted on many rows: so are its best rivals, before the two are compared.
        known = best.fit if best in larger else self.on_many_rows(best.fit)
        for one in rivals[:2]:
            full = self.on_many_rows(one.fit)
            if self.as_well(full, known):
                return replace(one, fit=full)
        return best

    def retuned(self) -> Fit:
        """The nominal hysteresis, with the timing and the start that suit it better."""
        alone = HysteresisModel(np.zeros(0), simulation=self.simulation)
        nominal = alone if self.simulation else self.plays()
        # A given simulation is taken at its word first: only the weights are solved for.
        h, _ = basis(self.chain, Hypothesis(nominal, self.start, remanent=True), None, MANY)
        each = [replace(h, alignment=a) for a in self.alignments]
        now = max(self.fits_here([(one, None, 0, FINE) for one in each]), key=self.score)
        for tolerance in (ROUGH, ROUGH, FINE):  # each with the weights that the last fit shows
            self.weigh(now)
            h, _ = basis(self.chain, now.hypothesis, None, MANY)
            others = [replace(h, alignment=a) for a in self.alignments if a != h.alignment]
            now = max(self.fits_here([(one, None, 8, tolerance) for one in (h, *others)]), key=self.score)
        (less,) = self.fits_here([(replace(now.hypothesis, remanent=False), None, 8, FINE)])
        if self.needs_no_history(now, less):
            now = less
        if self.noise is not None:
            # The noise of a monitored voltage is in what the simulation makes of a hold.
            self.noise = self.noise_in(now) or self.noise
        self.weigh(now)
        size = "gain and zero" if self.simulation else f"{nominal.size} plays"
        self.log(f"retuned, {size}: {rms_of(now)}")
        return now

    def noise_left(self, now: Fit) -> Noise | None:
        """The noise that a fit leaves: what a hold shows of hum, a drift or another axis is none once it
        has been explained."""
        if self.noise is None or self.slips:
            return self.noise
        left = self.noise_in(now)
        return left if left and left.rms_um < self.noise.rms_um else self.noise

    def noise_in(self, now: Fit) -> Noise | None:
        """What the residuals show of it."""
        chain = self.chain
        return noise_of_prediction(chain.records, self.lsb_um, chain.gain_um_per_v, now.residuals)

    def from_settled(self, retuned: Fit, now: Fit) -> tuple[Fit, Fit]:
        """Both without the readings in which a stage still settles from before a recording, if the better one
        shows any."""
        found = unsettled(self.chain.records, now.residuals)
        if self.slips or not any(found):
            return retuned, now
        self.unsettled = tuple(map(max, self.unsettled, found))
        self.chain = Chain(without_start(self.chain.records, found))
        both = []
        for one in (retuned, now):
            self.weigh(one)
            both += self.fits_here([(one.hypothesis, one.weights, 8, ROUGH)])
        self.log(f"a start that has not settled, left out: {rms_of(both[1])}")
        return both[0], both[1]

    def sticking(self, now: Fit) -> tuple[Fit, Tried] | None:
        """Stiction, if the readings show it, and the fit before it without a history: from then on
        everything is fitted where the mount slips."""
        if Stiction.name in now.hypothesis.names or self.noise is None:
            return None
        if now.hypothesis.remanent:  # a mount that has not slipped yet looks like a history
            (now,) = self.fits([(replace(now.hypothesis, remanent=False), None, 8, FINE)])
        found = slips(self.chain, now, self.noise.rms_um, self.lsb_um)
        if found is None:
            return None
        self.chain, self.slips = found.chain, found
        self.log(f"readings that hold and jump, a mount that sticks: one step ahead {rms_of(found.fit)}")
        return now, Tried(Stiction.name, found.fit, self.over(found.fit, now))

    def round(self, now: Fit) -> list[Tried]:
        """Every promising effect, and growth of the hysteresis, fitted on top of this, the best first."""
        fits = self.effects(now)
        leader = max([now, *(one for _, one in fits)], key=self.score)
        tried = [Tried(name, one, self.over(one, now, self.prior(now, one))) for name, one in fits]
        tried += self.growth(now, leader, self.larger())
        return sorted([t for t in tried if self.inside(t.fit, now)], key=lambda t: -t.gain.nats)

    def backward(self, now: Fit) -> Fit:
        """Without the effects that the others, or a larger hysteresis, have made needless."""
        grown = now.hypothesis.nominal.family != self.nominal.family
        while len(parts := self.parts(now)) > (0 if grown else 1):
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
        """The fit without one of its parts, for each."""
        return self.raced([(now.hypothesis.without(*p), now.weights, STEPS, ROUGH) for p in parts], now)

    def parts(self, now: Fit) -> list[tuple[str, str]]:
        """The added effects, and what each auxiliary signal does apart: names and signals."""
        members = now.hypothesis.members
        return list(dict.fromkeys((m.effect.name, m.aux) for m in members if m.effect.name not in self.given))


def is_larger(one: Tried) -> bool:
    """Whether a larger hysteresis was tried."""
    return one.name.startswith(OPERATOR)


def describe(one: Tried) -> str:
    return f"{one.gain.nats:.0f} ± {one.gain.sd:.0f} nats, {rms_of(one.fit)}"


def sticks(one: Tried) -> bool:
    """Whether an effect among what was tried is a hysteresis itself."""
    return any(effect.sticks for effect in effects_in(one))


def is_slow(one: Tried) -> bool:
    """Whether an effect among what was tried acts over seconds and more."""
    return any(effect.time_scale == "slow" for effect in effects_in(one))


def effects_in(one: Tried) -> list[type[Described]]:
    """The effects in the name of what was tried; none of a larger hysteresis."""
    there = {member.effect.name: member.effect for member in one.fit.hypothesis.members}
    return [there[name] for name in one.name.split(" + ") if name in there]
