"""What is tried on top of a hypothesis in a round of the search: every promising effect, from its best start.

Some explanations are only found together, or under another convention of timing: each alone, or the wrong
one, takes the place of both.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from torchpi.diagnosis.contest import HEAT, PRIOR, STEPS, Tried
from torchpi.diagnosis.fit import ROUGH
from torchpi.diagnosis.growth import Growth
from torchpi.diagnosis.hypothesis import EffectTerm, Fit, Hypothesis
from torchpi.diagnosis.modal import driven_modes
from torchpi.diagnosis.parallel import Job, screen_all
from torchpi.diagnosis.screen import Candidate, Screen, candidates_of
from torchpi.stage.effects.effect import Described, Effect, LinearEffect, Parameters
from torchpi.stage.effects.inside import InsideEffect
from torchpi.stage.effects.mechanics.cross_coupling import CrossCoupling
from torchpi.stage.effects.mechanics.resonance import Resonance
from torchpi.stage.effects.mechanics.second_mode import SecondMode

FORMS, STARTS = 3, 2
"""From how many forms an effect is fitted, and all axes through a mode."""
TRIED, FINISHED = 6, 4
"""How many effects are fitted in a round, the best of the screen; how many of these to the end."""
RICHER = 2
"""How many of them in a form of more numbers as well."""
AXES = "resonance + cross_coupling"


class Proposals(Growth):
    """Fits on given records of what a hypothesis may lack."""

    left_out: list[tuple[str, str]]
    """Effects that these records cannot show, and why."""
    needless: set[str]
    """Effects that others have replaced."""
    effects_tried: list[type[Effect] | type[InsideEffect]]

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
        # Of a form with fewer numbers, fitted to the end, one with more is found where it leads.
        ahead = sorted(finished, key=lambda name: -self.score(found[name]))[:RICHER]
        grown = {name: more for name in ahead if (more := self.richer(found[name].hypothesis, name))}
        again: list[Job] = [(more, found[name].weights, STEPS, ROUGH) for name, more in grown.items()]
        for name, one in zip(grown, self.fits(again, now), strict=True):
            if self.inside(one, now) and self.worth(one) > self.worth(found[name]):
                found[name] = one
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
