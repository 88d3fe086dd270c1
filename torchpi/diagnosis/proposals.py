"""Proposals of a search round: every promising effect is added to a hypothesis, from its best start.

Some explanations are only found jointly, or under another timing convention: otherwise one effect alone, or
the wrong convention, takes the place of both.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from torchpi.diagnosis.contest import HEAT, PRIOR, STEPS
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
"""Number of forms from which an effect is fitted, and of modes through which all axes are fitted jointly."""
TRIED, FINISHED = 6, 4
"""Number of effects, the best of the screen, fitted in a round; and number of these fitted to the end."""
RICHER = 2
"""How many of them are also fitted in a form with more parameters."""
AXES = "resonance + cross_coupling"


class Proposals(Growth):
    """Fits, on given records, of effects that a hypothesis may lack."""

    left_out: list[tuple[str, str]]
    """Effects that these records cannot show, and why."""
    needless: set[str]
    """Effects that others have replaced."""
    effects_tried: list[type[Effect] | type[InsideEffect]]

    def effects(self, now: Fit) -> list[tuple[str, Fit]]:
        """Return the most promising effects, each fitted from its best starts."""
        barred = {*self.needless, *(name for name, _ in self.left_out)}
        # An effect that takes an auxiliary signal may be present once for each signal.
        there = {(member.effect.name, member.aux) for member in now.hypothesis.members}
        starts = [
            member
            for member in [*self.starts, *self.from_residual(now, self.effects_tried)]
            if member.effect.name not in barred and (member.effect.name, member.aux) not in there
        ]
        (screened,) = screen_all(self.chain, [(now, starts)], self.executor)
        best: dict[str, dict[tuple[str, ...], Candidate]] = {}
        for candidate in sorted(screened, key=lambda c: -c.gain):
            member = candidate.member
            # An effect that only acts beyond a threshold, as a limit does, may show nothing to first order.
            if candidate.gain > -PRIOR or (candidate.gain > 0 and member.effect.name not in best):
                best.setdefault(member.effect.name, {}).setdefault(member.form, candidate)
        chosen = [(name, c) for name in list(best)[:TRIED] for c in list(best[name].values())[:FORMS]]
        # The start that would gain most after rescaling may be far from one that gains as it is.
        ready = {c.member.effect.name: c for c in sorted(screened, key=lambda c: c.at_once) if c.at_once > 0}
        chosen += [
            (name, c) for name in list(best)[:TRIED] if (c := ready.get(name)) and (name, c) not in chosen
        ]
        names = [name for name, _ in chosen]
        jobs: list[Job] = [(now.hypothesis.plus(c.member), now.weights, HEAT, ROUGH) for _, c in chosen]
        # A history absorbs a curvature behind it, and from there the joint fit does not reach the optimum.
        if now.hypothesis.remanent:
            for name, c in chosen:
                forgets = replace(now.hypothesis.plus(c.member), remanent=False)
                if self.chain.bends(forgets):
                    names.append(name)
                    jobs.append((forgets, None, STEPS, ROUGH))
        # An effect that delays is mistaken for a timing convention until it is fitted; and a mode driven by a
        # held command is not found if the command is taken to move between samples.
        otherwise = self.at_other_conventions(now, starts)
        names += otherwise
        jobs += [(h, now.weights, HEAT, ROUGH) for h in otherwise.values()]
        joint = self.axes_through_a_mode(now)
        names += [AXES] * len(joint)
        jobs += joint
        # A lag trades with a delay along a valley of the cost, of which two steps see little.
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
        # If other parameters have to change too, two steps achieve little of what the screen promised.
        promised = [name for name, c in chosen if self.score(now) + c.at_once > self.score(leader)]
        finished = list(dict.fromkeys([*best_first[:FINISHED], *promised]))
        unclear = [name for name in finished if name in promised or self.near(found[name], leader)]
        for place in range(FORMS):
            rest: list[Job] = [
                (forms[n][place].hypothesis, forms[n][place].weights, STEPS, ROUGH) for n in unclear
            ]
            found.update(zip(unclear, self.fits(rest, now), strict=True))
            # A form with more parameters may end on a bound at which it becomes a simpler one.
            unclear = [n for n in unclear if not self.inside(found[n], now) and len(forms[n]) > place + 1]
        # A form with more parameters is found by starting from a fully fitted form with fewer.
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
        """Return, for each effect that delays or responds differently to a held and to a moving command, its
        best start under another timing convention, if that is worth a fit."""
        h, best = now.hypothesis, dict[str, tuple[float, Hypothesis]]()
        other = h.alignment - 1 if h.alignment - 1 in self.alignments else h.alignment + 1
        (moved,) = self.fits([(replace(h, alignment=other), now.weights, 2, ROUGH)])
        dynamic = [member for member in starts if member.effect.hold]
        screens = [(moved, [m for m in starts if m.effect.delays or m.effect.hold])]
        if not any(member.effect.hold for member in h.members):  # else these would have to be refitted
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
        """Return hypotheses with both a one-parameter lag and a delay, under every timing convention. Either
        alone, or a lag with more parameters, takes the place of both, and no addition leads from there to the
        pair. What an outside simulation lacks internally looks like either; there they are tried singly."""
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
        """Return fits of all other axes with a mode: if a stage rings, each alone may explain little."""
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

    def from_residual(
        self, now: Fit, effects: Sequence[type[Effect] | type[InsideEffect]]
    ) -> list[EffectTerm]:
        """Return starts of these effects that no grid contains, from the residuals of the loudest and of the
        first recording."""
        records, found = self.chain.records, []
        residuals = [e[r.train] for e, r in zip(now.residuals, records, strict=True)]
        loudest = max(range(len(records)), key=lambda i: float(np.mean(residuals[i] ** 2)))
        for effect in effects:
            starts: list[Parameters] = []
            for i in sorted({loudest, 0}):
                y, fs_hz = records[i].y[records[i].train], records[i].fs_hz
                starts += effect.starts_from(self.seen, residuals[i], y, fs_hz)
            found += candidates_of(effect, records, starts, list(self.seen.aux))
        return found
