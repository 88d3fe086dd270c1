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
from torchpi.diagnosis.contest import ACCEPTED, HEAT, PRIOR, STEPS, Tried, explains_less
from torchpi.diagnosis.coverage import reason_to_leave_out
from torchpi.diagnosis.exchange import rms_of
from torchpi.diagnosis.fit import FINE, ROUGH
from torchpi.diagnosis.growth import OPERATOR, REVERSALS, Growth
from torchpi.diagnosis.hypothesis import EffectTerm, Fit, Hypothesis
from torchpi.diagnosis.hysteresis_model import HysteresisModel, bouc_wen, duhem
from torchpi.diagnosis.modal import driven_modes
from torchpi.diagnosis.noise import Noise, measured_noise
from torchpi.diagnosis.outside import Outside
from torchpi.diagnosis.parallel import Job, screen_all
from torchpi.diagnosis.reduced_basis import MANY, basis, refitted
from torchpi.diagnosis.screen import Candidate, Screen, candidates_of
from torchpi.diagnosis.stick_slip import Jump, Slips, jump, slips
from torchpi.stage.effects import EFFECTS
from torchpi.stage.effects.effect import Described, Effect, LinearEffect, Parameters
from torchpi.stage.effects.inside import InsideEffect
from torchpi.stage.effects.mechanics.cross_coupling import CrossCoupling
from torchpi.stage.effects.mechanics.resonance import Resonance
from torchpi.stage.effects.mechanics.second_mode import SecondMode
from torchpi.stage.effects.mechanics.stiction import Stiction

ROUNDS = 7
FORMS, STARTS = 3, 2
"""From how many forms an effect is fitted, and all axes through a mode."""
TRIED, FINISHED = 6, 4
"""How many effects are fitted in a round, the best of the screen; how many of these to the end."""
AXES = "resonance + cross_coupling"


@dataclass(frozen=True, eq=False)
class Round:
    """What was tried on top of one hypothesis, the best first."""

    before: Fit
    tried: tuple[Tried, ...]
    accepted: str | None
    """The name of what was taken."""


class Search(Growth):
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
        self.left_out: list[tuple[str, str]] = []
        self.needless: set[str] = set()
        self.slips: Slips | None = None
        self.jump: Jump | None = None
        """Of the final fit, where a mount sticks."""
        self.effects_tried: list[type[Effect] | type[InsideEffect]] = []
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
            if chosen is None or is_slow(chosen):
                # What has no wiping-out can do much that is physics of another kind: it comes last. Its loops
                # drift to where they close, which looks slow.
                last = self.growth(small, small, [duhem(self.seen)])
                last += self.walks(small) if chosen is None else []
                tried += [one for one in last if self.inside(one.fit, small)]
                chosen = self.simplest(tried, small)
            history.append(Round(now, tuple(tried), chosen.name if chosen else None))
            if chosen is None:
                break
            larger = chosen.name.startswith(OPERATOR)
            grown = self.sized(chosen.fit) if larger else self.at_its_own_weights(chosen.fit)
            # What explains less than the noise changes nothing of what was taken before.
            considerable = self.noise is None or not explains_less(grown, small, self.noise.rms_um)
            now = self.backward(self.swapped(self.realigned(grown)) if considerable else grown)
            self.needless |= set(chosen.fit.hypothesis.names) - set(now.hypothesis.names)
            self.log(f"  with {', '.join(now.hypothesis.names) or chosen.name}: {rms_of(now)}")
        self.weigh(now)
        if self.slips:
            self.jump = jump(self.slips, now)
        else:
            now = self.on_its_rows(self.at_the_tick(now))
        return retuned, now, history

    def on_its_rows(self, now: Fit) -> Fit:
        """The fit on many rows, where that predicts as well: there the prior holds all of a hysteresis, not
        only what was added to it last, and may bend a stage whose travel is many times the noise."""
        again = refitted(self.chain, now)
        return again if self.as_well(again, now) else now

    def simplest(self, tried: Sequence[Tried], now: Fit) -> Tried | None:
        """The best of what earns its place. An effect where a larger hysteresis is no clearer; the larger
        hysteresis where the effect is one itself: a play behind plays is plays."""
        earned = [
            one
            for one in tried
            if one.gain.probability > ACCEPTED
            and not self.faint(one.fit, now)
            and self.adequate(one.fit, now)
            and not (one.name.startswith(OPERATOR) and self.bends_to_all(one.fit, now))
        ]
        if not earned:
            return None
        larger = [one for one in earned if one.name.startswith(OPERATOR)]
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
            noise = measured_noise(self.chain.records, now.residuals)
            if noise is not None:
                self.noise = noise.with_converter(self.lsb_um)
        self.weigh(now)
        size = "gain and zero" if self.simulation else f"{nominal.size} plays"
        self.log(f"retuned, {size}: {rms_of(now)}")
        return now

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

    def effects(self, now: Fit) -> list[tuple[str, Fit]]:
        """The most promising effects, each fitted from its best starts."""
        barred = {*self.needless, *(name for name, _ in self.left_out)}
        # Of an effect with a signal of its own there may be one for each signal.
        there = {(member.effect.name, member.aux) for member in now.hypothesis.members}
        starts = [
            member
            for member in [*self.starts, *self.from_residual(now)]
            if member.effect.name not in barred
            and (member.effect.name, member.aux) not in there
            and member.effect.extrapolates(member.shared)
        ]
        (screened,) = screen_all(self.chain, [(now, starts)], self.executor)
        best: dict[str, dict[tuple[str, ...], Candidate]] = {}
        for candidate in sorted(screened, key=lambda c: -c.gain):
            member = candidate.member
            # What is seen only where it begins, as a limit is, may show nothing to first order.
            if candidate.gain > -PRIOR or (candidate.gain > 0 and member.effect.name not in best):
                best.setdefault(member.effect.name, {}).setdefault(member.form, candidate)
        chosen = [(name, c) for name in list(best)[:TRIED] for c in list(best[name].values())[:FORMS]]
        # What could gain most, if there were less or more of it, may be far from where it does gain.
        ready = {c.member.effect.name: c for c in sorted(screened, key=lambda c: c.at_once) if c.at_once > 0}
        chosen += [
            (name, c) for name in list(best)[:TRIED] if (c := ready.get(name)) and (name, c) not in chosen
        ]
        names = [name for name, _ in chosen]
        jobs: list[Job] = [(now.hypothesis.plus(c.member), now.weights, HEAT, ROUGH) for _, c in chosen]
        # A history takes the place of a curvature behind it, and leaves the fit of both no way to the end.
        if now.hypothesis.remanent:
            for name, c in chosen:
                forgets = replace(now.hypothesis.plus(c.member), remanent=False)
                if self.chain.bends(forgets):
                    names.append(name)
                    jobs.append((forgets, None, STEPS, ROUGH))
        # What delays is taken for the convention of timing until it is fitted; and a mode that a held command
        # drives is not found where the command is taken to move.
        otherwise = self.at_other_conventions(now, starts)
        names += otherwise
        jobs += [(h, now.weights, HEAT, ROUGH) for h in otherwise.values()]
        joint = self.axes_through_a_mode(now)
        names += [AXES] * len(joint)
        jobs += joint
        for name, h in self.lags_with_a_delay(now, screened):
            names.append(name)
            jobs.append((h, None, STEPS, ROUGH))
        by_name: dict[str, list[Fit]] = {}
        for name, one in zip(names, self.fits(jobs, now), strict=True):
            by_name.setdefault(name, []).append(one)
        forms = {name: sorted(each, key=self.worth, reverse=True) for name, each in by_name.items()}
        found = {name: each[0] for name, each in forms.items()}
        leader = max(found.values(), key=self.score, default=now)
        best_first = sorted(found, key=lambda name: -self.score(found[name]))
        # Where other numbers have to move as well, two steps keep little of what the screen promised.
        promised = [name for name, c in chosen if self.score(now) + c.at_once > self.score(leader)]
        finished = list(dict.fromkeys([*best_first[:FINISHED], *promised]))
        unclear = [name for name in finished if name in promised or self.near(found[name], leader)]
        for place in range(FORMS):
            rest: list[Job] = [
                (forms[n][place].hypothesis, forms[n][place].weights, STEPS, ROUGH) for n in unclear
            ]
            found.update(zip(unclear, self.fits(rest, now), strict=True))
            # A form of more numbers may run into a bound where it becomes a simpler one.
            unclear = [n for n in unclear if not self.inside(found[n], now) and len(forms[n]) > place + 1]
        fits = [(name, found[name]) for name in finished]
        if {effect.name for effect in (CrossCoupling, Resonance, SecondMode)} & (barred | self.given):
            return fits
        return [*fits, *driven_modes(self.chain, now, [one for _, one in fits], ROUGH)]

    def at_other_conventions(self, now: Fit, starts: Sequence[EffectTerm]) -> dict[str, Hypothesis]:
        """For what delays, or answers a held command otherwise than a moving one, the best start of all under
        another convention of timing, where it is worth a fit."""
        h, best = now.hypothesis, dict[str, tuple[float, Hypothesis]]()
        other = h.alignment - 1 if h.alignment - 1 in self.alignments else h.alignment + 1
        (moved,) = self.fits([(replace(h, alignment=other), now.weights, 2, ROUGH)])
        dynamic = [member for member in starts if member.effect.hold]
        screens = [(moved, [m for m in starts if m.effect.delays or m.effect.hold])]
        if not any(member.effect.hold for member in h.members):  # else what is there has to be fitted anew
            for one in (now, moved):
                held = replace(one.hypothesis, held=not h.held)
                screens.append((replace(one, hypothesis=held), dynamic))
        screened = screen_all(self.chain, screens, self.executor)
        for (one, _), candidates in zip(screens, screened, strict=True):
            lost = self.score(now) - self.score(one)
            for c in candidates:
                name, gained = c.member.effect.name, c.gain - lost
                if gained > max(-PRIOR, best[name][0] if name in best else 0.0):
                    best[name] = gained, one.hypothesis.plus(c.member)
        return {name: hypothesis for name, (_, hypothesis) in best.items()}

    def lags_with_a_delay(self, now: Fit, screened: Sequence[Candidate]) -> list[tuple[str, Hypothesis]]:
        """A lag of one number and a delay at once, under every convention of timing. Each alone, or a lag of
        more numbers, takes the place of both, and from there no addition leads to the two. What a simulation
        that is only called lacks inside looks like either: there they are tried one by one."""
        if self.simulation:
            return []
        h, best = now.hypothesis, dict[type[Described], EffectTerm]()
        for c in sorted(screened, key=lambda c: -c.gain):
            if c.member.effect.delays and len(c.member.shared) == 1 and c.gain > -PRIOR:
                best.setdefault(c.member.effect, c.member)
        for member in h.members:
            effect, mine = member.effect, member.shared
            starts = [s.shared for s in self.starts if s.effect is effect and s.shared.keys() <= mine.keys()]
            simplest = min(starts, key=len, default={})
            if effect.delays and len(simplest) == 1 and effect.name not in self.given:
                best[effect] = replace(member, shared={name: mine[name] for name in simplest})
        found = []
        linear = [member for effect, member in best.items() if issubclass(effect, LinearEffect)]
        for lag in (member for member in linear if not member.effect.commutes):
            for delay in (member for member in linear if member.effect.commutes):
                two = h.without(lag.effect.name).without(delay.effect.name).plus(lag).plus(delay)
                added = [m.effect.name for m in (lag, delay) if m.effect.name not in h.names]
                if added:
                    name = " + ".join(added)
                    found += [(name, replace(two, alignment=a)) for a in self.alignments]
        return found

    def axes_through_a_mode(self, now: Fit) -> list[Job]:
        """Every other axis and a resonance at once: each alone may explain little of a stage that rings."""
        aux = list(self.seen.aux)
        if not aux or {"cross_coupling", "resonance"} & set(now.hypothesis.names):
            return []
        modes, screen = [m for m in self.starts if m.effect is Resonance], Screen(self.chain, now)
        found = [
            (screen.gain(screen.off_tangent(screen.of_inputs(mode, aux))), place)
            for place, mode in enumerate(modes)
        ]
        couplings = [member for member in self.starts if member.effect is CrossCoupling]
        jobs: list[Job] = []
        for worth, place in sorted(found, reverse=True)[:STARTS]:
            if worth > -PRIOR:
                hypothesis = now.hypothesis.plus(modes[place])
                for coupling in couplings:
                    hypothesis = hypothesis.plus(coupling)
                jobs.append((hypothesis, now.weights, STEPS, ROUGH))
        return jobs

    def walks(self, now: Fit) -> list[Tried]:
        """Random walks, which take the place of anything slow and come last: where something is left that
        does not repeat with the voltage, each from the knots that explain most of it."""
        there = {*now.hypothesis.names, *self.needless, *(name for name, _ in self.left_out)}
        starts = [
            member
            for member in self.starts
            if member.effect.name not in there and not member.effect.extrapolates(member.shared)
        ]
        if not starts or not self.chain.weighting.above_noise_apart(now):
            return []
        screen = Screen(self.chain, now)
        begun = [now.hypothesis.plus(screen.solved(member)) for member in starts]
        fits = self.fits([(h, now.weights, STEPS, ROUGH) for h in begun], now)
        tried = [
            Tried(member.effect.name, one, self.over(one, now, self.prior(now, one)))
            for member, one in zip(starts, fits, strict=True)
        ]
        return sorted(tried, key=lambda one: -one.gain.nats)

    def from_residual(self, now: Fit) -> list[EffectTerm]:
        """Starts that no grid has: where the residual of the loudest recording, or the first, stands out."""
        records, found = self.chain.records, []
        residuals = [e[r.train] for e, r in zip(now.residuals, records, strict=True)]
        loudest = max(range(len(records)), key=lambda i: float(np.mean(residuals[i] ** 2)))
        for effect in self.effects_tried:
            starts: list[Parameters] = []
            for i in sorted({loudest, 0}):
                y, fs_hz = records[i].y[records[i].train], records[i].fs_hz
                starts += effect.starts_from(self.seen, residuals[i], y, fs_hz)
            found += candidates_of(effect, records, starts, list(self.seen.aux))
        return found

    def backward(self, now: Fit) -> Fit:
        """Without the effects that the others have made needless."""
        while len(parts := self.parts(now)) > 1:
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
