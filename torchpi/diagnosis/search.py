"""Search: the nominal hysteresis first, then one effect after another, everything refitted each time.

Growth of the hysteresis is a candidate among the others: what a larger hysteresis explains as well as an
effect does is not evidence of that effect, and the other way round.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
import torch

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.compressed import compressed
from torchpi.diagnosis.coverage import reason_to_leave_out
from torchpi.diagnosis.evidence import evidence
from torchpi.diagnosis.fit import FINE, ITERATIONS, ROUGH, fit, sum_of_squares
from torchpi.diagnosis.held_out import explained, gain, typical_um, unexplained
from torchpi.diagnosis.hypothesis import Fit, Hypothesis, Member
from torchpi.diagnosis.intervals import intervals_90, undetermined
from torchpi.diagnosis.mains import hums, lines_hz
from torchpi.diagnosis.modal import driven_modes
from torchpi.diagnosis.noise import noise_floor_um
from torchpi.diagnosis.nominal import Nominal, bouc_wen, duhem, many_plays, plain, preisach
from torchpi.diagnosis.parallel import Job, fit_all, screen_all
from torchpi.diagnosis.records import seen
from torchpi.diagnosis.screen import Candidate, Screen, candidates_of
from torchpi.diagnosis.slips import Jump, Slips, jump, slips
from torchpi.stage.effects import EFFECTS
from torchpi.stage.effects.mechanics.cross_coupling import CrossCoupling
from torchpi.stage.effects.mechanics.resonance import Resonance, peaks_hz
from torchpi.stage.effects.mechanics.second_mode import SecondMode
from torchpi.stage.effects.mechanics.stiction import Stiction
from torchpi.stage.effects.sensor.hum import Hum

LEAST_GAIN = 0.03
"""By how much an effect must lower the error, on the samples it was fitted to and on those held out."""
RECORDED_GAIN = 0.01
"""The same for what follows a signal that was recorded."""
LEAST_SHARE = 0.2
"""Of the mismatch over the floor that an effect must explain."""
LEAST_EVIDENCE = 8.0
"""Log-likelihood that an effect must gain, beside that of its parameters."""
PER_PARAMETER = 3.0
STARTS, HEAT = 2, 4
"""From how many starts an effect is fitted; the steps after which only the best of them goes on."""
AXES = "resonance + cross_coupling"
SLOW = ("amplifier_lag", "slew_limit", "delay", "sensor_lag")
DELAYING = (*SLOW, "resonance", "second_mode")
OPERATOR = "hysteresis_operator: "
"""How a larger hysteresis is called among the explanations, before its family."""
PREISACH = ((20, 60, 5), (15, 35, 7))
"""Plays spread in the logarithm, plays spread evenly, degree: what a Preisach operator may grow to."""
TRIED = 6
"""How many effects are fitted in a round, the best of the screen."""
PAIRS = 3
"""How many of a round's best are fitted with all rows before one is chosen."""
SIMPLER = 1.05
"""How much worse an effect of few numbers may fit than a larger hysteresis, and be taken for it."""
NEAR = 1.5
"""Times the floor: another family of hysteresis is not looked for below."""
FINISHED = 1.02
"""Times the floor: an error within this leaves nothing to look for."""
SAMPLES_A_PLAY = 10
"""Shorter recordings than so many samples for each of a hundred plays get ten plays."""
NEGLIGIBLE = 1e-6
"""Of the travel: less than this no sensor resolves."""
MINOR = 0.01
"""Of the mismatch: an effect that explains less must have numbers that the recordings tell."""
OUTWEIGHS = 2.0
"""How many times what nothing explains an effect must explain to be named."""
LARGE = 200
"""Rows from which a fit with all of them is worth sparing."""
HOPELESS = 3.0
"""A family of hysteresis that fits this many times worse than another is not tried again."""


@dataclass(frozen=True, eq=False)
class Tried:
    """A hypothesis that was fitted in a round."""

    name: str
    fit: Fit
    evidence: float
    """Log-likelihood gained over the hypothesis before."""


@dataclass(frozen=True, eq=False)
class Round:
    """What was tried on top of one hypothesis, the best first."""

    before: Fit
    tried: tuple[Tried, ...]
    accepted: str | None
    """The name of what was taken."""


class Search:
    """A search on given records."""

    def __init__(
        self,
        chain: Chain,
        say: Callable[[str], None],
        given: Sequence[Member] = (),
        floor_um: float | None = None,
        executor: Executor | None = None,
        lsb_um: float = 0.0,
    ) -> None:
        self.chain, self.say, self.start, self.floor = chain, say, tuple(given), floor_um
        self.lsb_um = lsb_um
        self.executor = executor
        self.left_out: list[tuple[str, str]] = []
        self.given = {member.effect.name for member in given}
        self.seen = seen(chain.records)
        self.hopeless: set[str] = set()
        self.needless: set[str] = set()
        self.witnessed: set[str] = set()
        """Names for which a recorded signal stands, however much else is left: they are not sifted."""
        self.slips: Slips | None = None
        self.jump: Jump | None = None
        """Of the final fit, where a mount sticks."""
        self.lessened: tuple[tuple[object, ...], list[Fit]] | None = None
        self.starts: list[Member] = []
        for effect in EFFECTS:
            starts = candidates_of(effect, chain.records, effect.starts(self.seen), list(self.seen.aux))
            if why := reason_to_leave_out(effect, chain.records, self.seen, len(starts)):
                self.left_out.append((effect.name, why))
            else:
                self.starts += starts

    def run(self, rounds: int = 5) -> tuple[Fit, Fit, list[Round]]:
        """The retuned nominal, the best hypothesis, and the rounds: forward, with a backward check."""
        nominal = many_plays(self.seen)
        if sum(len(record.fitted) for record in self.chain.records) < SAMPLES_A_PLAY * nominal.size:
            nominal = plain(self.seen)
        retuned = now = min(
            (fit(self.chain, Hypothesis(nominal, self.start, a)) for a in (0, 1)), key=lambda f: f.train_rms
        )
        self.say(f"retuned, {len(now.weights) - 1} plays: {describe(now)}")
        history: list[Round] = []
        for number in range(1, rounds + 1):
            done = max(FINISHED * (self.floor or 0.0), NEGLIGIBLE * self.seen.span_um)
            # The mains hum while the stage rests as well: a floor from rests has them in it.
            if now.heldout_rms < done and not hums(now, self.chain.records):
                break
            if found := self.sticking(now):
                history.append(Round(now, (found,), found.name))
                now = found.fit
            small = compressed(self.chain, now)
            tried = self.round(small)
            taken = [one for one in tried if self.takes(one, small)]
            best = f"; best {tried[0].name}, {describe(tried[0].fit)}" if tried else ""
            self.say(f"round {number}: {len(tried)} explanations fitted{best}")
            chosen = self.chosen(taken) if taken else None
            history.append(Round(now, tuple(tried), chosen.name if chosen else None))
            if chosen is None:
                break
            grown = self.sized(chosen.fit) if chosen.name.startswith(OPERATOR) else chosen.fit
            now = self.backward(self.realigned(grown))
            self.see_the_floor_in(now)
            if recorded(chosen.name):
                self.witnessed |= set(chosen.name.split(" + "))
            self.needless |= set(chosen.fit.hypothesis.names) - set(now.hypothesis.names)
            self.say(f"  with {', '.join(now.hypothesis.names) or chosen.name}: {describe(now)}")
        final = self.determined(self.sifted(self.as_plays(now, retuned)), retuned)
        if self.slips:
            self.jump = jump(self.slips, final)
        return retuned, final, history

    def sticking(self, now: Fit) -> Tried | None:
        """Stiction, if the readings show it: from then on everything is fitted where the mount slips."""
        if Stiction.name in now.hypothesis.names or not self.floor:
            return None
        found = slips(self.chain, now, self.floor, self.lsb_um)
        if found is None:
            return None
        self.chain, self.slips = found.chain, found
        self.witnessed.add(Stiction.name)
        self.say(
            f"readings that rest and jump, a mount that sticks: {describe(found.fit)} is left from one "
            "reading to the next"
        )
        return Tried(Stiction.name, found.fit, evidence(now.residuals, found.fit.residuals))

    def sifted(self, now: Fit) -> Fit:
        """Without the effects that explain little beside what nothing explains."""
        while added := self.added(now):
            small = compressed(self.chain, now)
            fits = self.without_each(small)
            worth = {
                name: (self.outweighs(small, less), less)
                for name, less in zip(added, fits, strict=True)
                if name not in self.witnessed
            }
            name = min(worth, key=lambda name: worth[name][0], default=None)
            if name is None or worth[name][0] > 0:
                break
            self.say(f"  without {name}: it explains too little beside what nothing explains")
            now = self.polished(worth[name][1])
        return now

    def determined(self, now: Fit, retuned: Fit) -> Fit:
        """Without the effects that explain next to nothing, and have a number that nothing tells.

        Two such, as a lag and a damped mode, often stand for what the solver of another's equation leaves.
        """
        while added := self.added(now):
            loose = undetermined(now, intervals_90(self.chain, now)) - self.witnessed
            small = compressed(self.chain, now)
            mismatch = retuned.heldout_rms**2 - self.floor_um(now) ** 2
            rises = {
                name: (less.heldout_rms**2 - small.heldout_rms**2, less)
                for name, less in zip(added, self.without_each(small), strict=True)
                if name in loose
            }
            name = min(rises, key=lambda name: rises[name][0], default=None)
            if name is None or rises[name][0] > MINOR * mismatch:
                break
            self.say(f"  without {name}: it explains next to nothing, and its numbers are not told")
            now = self.polished(rises[name][1])
        return now

    def as_plays(self, now: Fit, retuned: Fit) -> Fit:
        """On the plain hysteresis again, unless another explains as much more as an effect must."""
        if now.hypothesis.nominal.family == retuned.hypothesis.nominal.family:
            return now
        less = fit(self.chain, now.hypothesis.on(retuned.hypothesis.nominal))
        if self.outweighs(now, less) > 0:
            return now
        self.say(f"  on plays, not {now.hypothesis.nominal.family}: that explains too little more")
        return less

    def see_the_floor_in(self, now: Fit) -> None:
        """What follows another axis, or the mains, is in the rests too: the floor is what it leaves there."""
        if self.floor is not None:
            left = [replace(r, y=e) for r, e in zip(self.chain.records, now.residuals, strict=True)]
            self.floor = min(self.floor, noise_floor_um(left, self.lsb_um) or self.floor)

    def outweighs(self, now: Fit, less: Fit) -> float:
        """Positive where now explains as much more than less as it must, beside what nothing explains.

        In all squares, where it shows in few places, or block by block, where the model misses some by far.
        """
        records, floor = self.chain.records, self.floor_um(now)
        left = unexplained(records, now, less, floor)
        over = max(now.heldout_rms**2 - floor**2, 0.0)
        gained = less.heldout_rms**2 - now.heldout_rms**2
        return max(
            explained(records, now, less) - OUTWEIGHS * left,
            (gained - OUTWEIGHS * over) / max(less.heldout_rms, now.heldout_rms) ** 2,
        )

    def added(self, now: Fit) -> list[str]:
        """The effects that the simulation did not have."""
        return [name for name in dict.fromkeys(now.hypothesis.names) if name not in self.given]

    def floor_um(self, now: Fit) -> float:
        """The noise floor, at most what the fit has reached."""
        return min(now.heldout_rms, now.train_rms, self.floor if self.floor else np.inf)

    def round(self, now: Fit) -> list[Tried]:
        """Every promising effect, and growth of the hysteresis, fitted on top of this."""
        fits = self.effects(now) + self.growth(now)
        tried = [
            Tried(name, one, evidence(now.residuals, one.residuals)) for name, one in fits if not one.bounded
        ]
        return sorted(tried, key=lambda t: self.typical_um(t.fit) * t.fit.train_rms)

    def typical_um(self, one: Fit) -> float:
        """Its error in a held-out block."""
        return typical_um(self.chain.records, one)

    def effects(self, now: Fit) -> list[tuple[str, Fit]]:
        """The most promising effects, each fitted from its best starts."""
        barred = {*self.needless, *(name for name, _ in self.left_out)}
        # Of an effect with a signal of its own there may be one for each signal.
        there = {(member.effect.name, member.aux) for member in now.hypothesis.members}
        starts = [
            member
            for member in [*self.starts, *self.from_residual(now)]
            if member.effect.name not in barred and (member.effect.name, member.aux) not in there
        ]
        bases = self.bases(now)
        dynamic = [member for member in starts if member.effect.hold]
        screens = list(zip(bases, (starts, dynamic), strict=False))
        screened = [c for each in screen_all(self.chain, screens, self.executor) for c in each]
        best: dict[str, list[Candidate]] = {}
        for candidate in sorted(screened, key=lambda c: -c.gain):
            if candidate.gain > LEAST_GAIN / 2:
                best.setdefault(candidate.member.effect.name, []).append(candidate)
        names = [name for name in list(best)[:TRIED] for _ in best[name][:STARTS]]
        jobs: list[Job] = [
            (replace(now.hypothesis.plus(c.member), held=c.held), now.weights, HEAT, ROUGH)
            for name in list(best)[:TRIED]
            for c in best[name][:STARTS]
        ]
        # What delays is taken for the convention of timing until it is fitted: each is tried under both.
        late = {name: job[0] for name, job in reversed([*zip(names, jobs, strict=True)]) if name in DELAYING}
        late |= self.at_the_other_timing(now, starts)
        names += late
        jobs += [(replace(h, alignment=1 - h.alignment), now.weights, HEAT, ROUGH) for h in late.values()]
        joint = self.axes_through_a_mode(now, bases)
        names += [AXES] * len(joint)
        jobs += joint
        found: dict[str, Fit] = {}
        for name, one in zip(names, self.fits(jobs), strict=True):
            found[name] = min(one, found.get(name, one), key=lambda f: f.train_rms)
        rest: list[Job] = [(f.hypothesis, f.weights, ITERATIONS, ROUGH) for f in found.values()]
        fits = list(zip(found, self.fits(rest), strict=True))
        if {effect.name for effect in (CrossCoupling, Resonance, SecondMode)} & (barred | self.given):
            return fits
        return [*fits, *driven_modes(self.chain, now, [one for _, one in fits], ROUGH)]

    def bases(self, now: Fit) -> list[Fit]:
        """What candidates are added to: with the displacement stepped as well, as long as none holds it."""
        if now.hypothesis.held or any(member.effect.hold for member in now.hypothesis.members):
            return [now]
        return [now, replace(now, hypothesis=replace(now.hypothesis, held=True))]

    def at_the_other_timing(self, now: Fit, starts: Sequence[Member]) -> dict[str, Hypothesis]:
        """For what is slow the best start of all under the other convention, where it is worth a fit."""
        other = replace(now.hypothesis, alignment=1 - now.hypothesis.alignment)
        (moved,) = self.fits([(other, now.weights, 2, ROUGH)])
        here, there = (sum_of_squares(self.chain, f.hypothesis, f.weights) for f in (now, moved))
        slow = [member for member in starts if member.effect.name in SLOW]
        (screened,) = screen_all(self.chain, [(moved, slow)], self.executor)
        worth = [c for c in screened if (1 - c.gain) * there < (1 - LEAST_GAIN / 2) * here]
        return {
            c.member.effect.name: now.hypothesis.plus(c.member) for c in sorted(worth, key=lambda c: c.gain)
        }

    def axes_through_a_mode(self, now: Fit, bases: Sequence[Fit]) -> list[Job]:
        """Every other axis and a resonance at once: each alone may explain little of a stage that rings."""
        aux = list(self.seen.aux)
        if not aux or {"cross_coupling", "resonance"} & set(now.hypothesis.names):
            return []
        modes = [member for member in self.starts if member.effect is Resonance]
        found = [
            (screen.gain(screen.off_tangent(screen.of_inputs(mode, aux))), base.hypothesis.held, place)
            for base in bases
            for screen in (Screen(self.chain, base),)
            for place, mode in enumerate(modes)
        ]
        couplings = [member for member in self.starts if member.effect is CrossCoupling]
        jobs: list[Job] = []
        for worth, held, place in sorted(found, reverse=True)[:STARTS]:
            if worth > LEAST_GAIN / 2:
                hypothesis = now.hypothesis.plus(modes[place])
                for coupling in couplings:
                    hypothesis = hypothesis.plus(coupling)
                jobs.append((replace(hypothesis, held=held), now.weights, 2 * HEAT, ROUGH))
        return jobs

    def fits(self, jobs: Sequence[Job]) -> list[Fit]:
        """Each hypothesis fitted from its weights, in the executor if there is one."""
        return fit_all(self.chain, jobs, self.executor)

    def from_residual(self, now: Fit) -> list[Member]:
        """Starts at the frequencies where the residual stands out."""
        records, found = self.chain.records, []
        loudest = max(range(len(records)), key=lambda i: float(np.mean(now.residuals[i] ** 2)))
        peaks: list[float] = []
        for i in {loudest, 0}:
            peaks += peaks_hz(torch.from_numpy(now.residuals[i]), records[i].fs_hz)
        for effect in (Resonance, SecondMode):
            found += candidates_of(effect, records, effect.starts_at(self.seen, peaks), [])
        lines = {round(line, 3) for line in lines_hz(now, records)}
        size = 1e-3 * self.seen.span_um
        found += candidates_of(
            Hum, records, [{"frequency_hz": f, "cos_um": size, "sin_um": size} for f in sorted(lines)], []
        )
        return found

    def growth(self, now: Fit) -> list[tuple[str, Fit]]:
        """A larger hysteresis in the place of the present one."""
        h, found = now.hypothesis, []
        if h.nominal.family != "prandtl_ishlinskii" and self.typical_um(now) < NEAR * self.floor_um(now):
            return []
        larger: list[tuple[str, Nominal, tuple[str, ...], int]] = [("preisach", preisach(self.seen), (), 4)]
        larger.append(("bouc_wen", bouc_wen(self.seen, 0.1), ("sigma_v", "beta", "exponent"), 15))
        larger.append(("duhem", duhem(self.seen, 5.0), ("alpha_per_v",), 10))
        larger = [one for one in larger if one[0] not in {*self.hopeless, h.nominal.family}]
        jobs = [(h.on(nominal, shape), None, steps, ROUGH) for _, nominal, shape, steps in larger]
        for (family, *_), one in zip(larger, self.fits(jobs), strict=True):
            found.append((OPERATOR + family, one))
        for family in {family for family, *_ in larger} - self.hopeless:
            if min(f.train_rms for n, f in found if n.endswith(family)) > HOPELESS * now.train_rms:
                self.hopeless.add(family)
        return found

    def chosen(self, taken: list[Tried]) -> Tried:
        """The best with all rows of its hysteresis; an effect of few numbers before a larger hysteresis."""
        rows = [one.fit.hypothesis.nominal.mixing for one in taken]
        if max(0 if mixing is None else mixing.shape[1] for mixing in rows) > LARGE:
            return replace(taken[0], fit=self.polished(taken[0].fit))
        effects = [t for t in taken if not t.name.startswith(OPERATOR)][:PAIRS]
        full = [replace(one, fit=self.polished(one.fit)) for one in dict.fromkeys([*taken[:1], *effects])]
        full = [one for one in full if not one.fit.bounded] or full[:1]
        best = min(full, key=lambda t: self.typical_um(t.fit))
        named = [t for t in full if not t.name.startswith(OPERATOR)]
        first = min(named, key=lambda t: self.typical_um(t.fit), default=best)
        return first if self.typical_um(first.fit) < SIMPLER * self.typical_um(best.fit) else best

    def sized(self, now: Fit) -> Fit:
        """A Preisach operator with as many numbers as the held-out samples carry."""
        h = now.hypothesis
        if h.nominal.family != "preisach":
            return now
        jobs: list[Job] = [(h.on(preisach(self.seen, *size)), None, 2, FINE) for size in PREISACH]
        return min([now, *self.fits(jobs)], key=self.typical_um)

    def takes(self, one: Tried, now: Fit) -> bool:
        """Whether an effect earns its place."""
        grown = one.fit.hypothesis.nominal.size - now.hypothesis.nominal.size
        slots = len(one.fit.slots) - len(now.slots) + max(0, grown)
        records = self.chain.records
        least, share = (RECORDED_GAIN, 0.0) if recorded(one.name) else (LEAST_GAIN, LEAST_SHARE)
        return (
            one.fit.train_rms < (1 - least) * now.train_rms
            and gain(records, one.fit, now) > least
            and one.fit.heldout_rms < (1 + LEAST_GAIN) * now.heldout_rms
            and one.evidence > LEAST_EVIDENCE + PER_PARAMETER * slots
            and explained(records, one.fit, now) > share * unexplained(records, now, now, self.floor or 0.0)
        )

    def polished(self, now: Fit) -> Fit:
        """With all rows of the hysteresis again."""
        nominal = now.hypothesis.nominal
        if nominal.mixing is None:
            return now
        full = now.hypothesis.on(replace(nominal, mixing=None), now.hypothesis.shape)
        weights = np.append(nominal.mixing.T @ now.weights[:-1], now.weights[-1])
        return fit(self.chain, full, weights, 5 if len(weights) < LARGE else 2)

    def realigned(self, now: Fit) -> Fit:
        """Under the conventions of timing that fit best: they are no physics."""
        small = compressed(self.chain, now)
        others = [
            replace(small.hypothesis, alignment=alignment, held=held)
            for alignment in (0, 1)
            for held in (False, True)
            if (alignment, held) != (now.hypothesis.alignment, now.hypothesis.held)
        ]
        fits = [f for f in self.fits([(h, small.weights, 6, ROUGH) for h in others]) if not f.bounded]
        best = min([small, *fits], key=lambda f: f.train_rms)
        return now if best is small else self.polished(best)

    def backward(self, now: Fit) -> Fit:
        """Without the effects that the others have made needless."""
        while len(parts := self.parts(now)) > 1:
            small = compressed(self.chain, now)
            jobs: list[Job] = [
                (small.hypothesis.without(*part), small.weights, ITERATIONS, ROUGH) for part in parts
            ]
            for (name, aux), less in zip(parts, self.fits(jobs), strict=True):
                gained = evidence(less.residuals, small.residuals)
                if not self.takes(Tried(name, small, gained), less):
                    self.say(f"  without {' of '.join(filter(None, (name, aux)))}: the others do its work")
                    now = self.polished(less)
                    break
            else:
                return now
        return now

    def without_each(self, now: Fit) -> list[Fit]:
        """The fit without one of the added effects, for each."""
        # What the last sifting left is what is decided on: the same fits again.
        h = now.hypothesis
        what = (
            h.members,
            h.alignment,
            h.held,
            h.nominal.structure,
            *h.nominal.shape.values(),
            now.weights.tobytes(),
        )
        if self.lessened is None or self.lessened[0] != what:
            hypotheses = [h.without(name) for name in self.added(now)]
            fits = self.fits([(less, now.weights, ITERATIONS, ROUGH) for less in hypotheses])
            self.lessened = (what, fits)
        return self.lessened[1]

    def parts(self, now: Fit) -> list[tuple[str, str]]:
        """The added effects, and what each auxiliary signal does apart: names and signals."""
        members = now.hypothesis.members
        return list(dict.fromkeys((m.effect.name, m.aux) for m in members if m.effect.name not in self.given))


def recorded(name: str) -> bool:
    """Whether it takes a signal that was recorded beside the voltage: nothing else follows that by chance."""
    return any(effect.takes_aux and effect.name in name.split(" + ") for effect in EFFECTS)


def describe(one: Fit) -> str:
    return f"{one.train_rms * 1e3:.3f} nm, held out {one.heldout_rms * 1e3:.3f} nm"
