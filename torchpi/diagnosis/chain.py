"""Evaluation of hypotheses on recordings: displacement, and its derivatives along rows and parameters."""

import pickle
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property, partial
from hashlib import sha256
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchpi.diagnosis.hypothesis import Hypothesis
from torchpi.diagnosis.hysteresis_model import HysteresisModel
from torchpi.diagnosis.records import Record, Rests
from torchpi.diagnosis.score import Weighting
from torchpi.operators.discrete_block import DiscreteBlock
from torchpi.stage.effects.effect import Effect, LinearEffect, StateSpaceEffect, without_idle_poles
from torchpi.stage.effects.held import BetweenSamples, between_samples
from torchpi.stage.effects.inside import InsideEffect
from torchpi.stage.effects.mechanics.modal import ModalEffect
from torchpi.stage.effects.mechanics.modes import Modes, Part
from torchpi.stage.effects.mechanics.stiction import Stiction

SIGNALS = 60
"""Maximum number of cached signals inside the chain."""
MADE = 2000
"""Maximum number of cached effects with given parameters; also of cached blocks and arrangements."""
AT_ONCE = 128
"""Rows over time that are processed at once: all rows of a large hysteresis take some hundred megabytes."""
REMEMBERED = 200_000_000
"""Maximum bytes of cached rows, kept because successive candidates act behind the same hysteresis."""


class Placed(NamedTuple):
    """An effect in the chain of one recording, with the auxiliary signal that it takes.

    A linear effect starts at rest: its input is taken to have had its first value for a long time.
    """

    effect: Effect
    aux: Tensor | tuple[Tensor, ...] | None
    key: tuple[object, ...]
    """Cache key that distinguishes it from other effects."""
    block: DiscreteBlock | None
    """For an effect with few states, what runs it."""

    def __call__(self, x: Tensor) -> Tensor:
        if self.aux is None and isinstance(self.effect, LinearEffect):
            return self.of_deviation(x)
        # Only an effect that takes a second signal accepts one.
        y: Tensor = (self.effect(x) if self.aux is None else self.effect(x, None, self.aux))[0]
        return y

    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        """Return the derivative of the output along each direction, (directions, time)."""
        if self.aux is None and isinstance(self.effect, LinearEffect):
            return self.of_deviation(dx)
        return self.effect.tangent(x, dx)

    def of_deviation(self, x: Tensor) -> Tensor:
        """Return the response of a linear effect to rows, (rows, time), at rest at their first sample."""
        if self.block is None:
            moved: Tensor = self.effect(x - x[:, :1])[0]
            return moved.add_(x[:, :1])
        u = x.numpy()
        y = self.block(u - u[:, :1])
        y += u[:, :1]
        return torch.from_numpy(y)


class Arrangement(NamedTuple):
    """The chain of a hypothesis for one recording."""

    nominal: HysteresisModel
    """The hysteresis, including the effects that act inside it."""
    effects: list[Placed]
    """Every effect outside it, in the order of the chain."""
    before: list[Placed]
    """Those that precede the hysteresis."""
    after: list[Placed]
    """Those that follow it."""
    key: tuple[object, ...]
    """Cache key of the states: everything that they depend on."""


class Chain:
    """Evaluates hypotheses on these recordings."""

    def __init__(self, records: Sequence[Record], weighting: Weighting | None = None) -> None:
        self.records = records
        self.weighting = weighting or Weighting.flat(records)
        """The weight of each coefficient."""
        self.remembered: dict[tuple[object, ...], np.ndarray] = {}
        self.signals: dict[tuple[object, ...], Tensor] = {}
        self.made: dict[tuple[object, ...], Effect] = {}
        self.blocks: dict[tuple[object, ...], tuple[Effect, DiscreteBlock | None]] = {}
        self.linearised: Any = None
        """Sensitivities that many fits start from, with a key for the point at which they were taken."""
        self.arrangements: dict[tuple[Hypothesis, int], Arrangement] = {}

    @cached_property
    def packed(self) -> tuple[str, bytes]:
        """A key that identifies the recordings, and the recordings pickled for another process."""
        content = pickle.dumps(self.records)
        return sha256(content).hexdigest(), content

    @cached_property
    def span_v(self) -> float:
        """The largest travel of the command in any recording, V."""
        return max(float(np.ptp(record.u)) for record in self.records)

    @cached_property
    def span_um(self) -> float:
        """The largest travel of the readings in any recording, µm."""
        return max(float(np.ptp(record.y)) for record in self.records) or 1e-9

    @property
    def gain_um_per_v(self) -> float:
        """Ratio of the largest travels."""
        return self.span_um / (self.span_v or 1.0)

    def numbers(self, hypothesis: Hypothesis) -> int:
        """Number of weights: those of the rows, and the history and the zero of each recording."""
        return hypothesis.nominal.kept + len(self.records) * (1 + hypothesis.history)

    def whitened(self, index: int, rows: np.ndarray) -> np.ndarray:
        """(rows, kept): Haar coefficients of rows, (rows, time), each divided by its standard deviation."""
        found = self.records[index].coefficients(rows)
        found *= self.weighting.inverse_sd[index]
        return found

    def output(self, hypothesis: Hypothesis, weights: np.ndarray, index: int) -> np.ndarray:
        """(time,), µm: the output for one recording. Its zero is added behind all effects."""
        return self.output_of(hypothesis, weights, index, self.signals_behind(hypothesis, weights, index))

    def signals_behind(self, hypothesis: Hypothesis, weights: np.ndarray, index: int) -> list[Tensor]:
        """(1, time) each, cached: the displacement of the hysteresis, then the output of each effect."""
        arranged = self.arranged(hypothesis, index)
        path: tuple[object, ...] = (arranged.key, weights.tobytes())
        x = partial(self.displacement, hypothesis, weights, index)
        found = [self.signal(path, lambda: torch.from_numpy(x())[None])]
        for placed in arranged.after:
            path = (*path, placed.key)
            found.append(self.signal(path, partial(placed.__call__, found[-1])))
        return found

    def signal(self, path: tuple[object, ...], make: Callable[[], Tensor]) -> Tensor:
        """One of the signals last used, which successive candidates share, or else a new one."""
        known = self.signals.pop(path, None)
        if known is None:
            with torch.no_grad():
                known = make()
        if len(self.signals) >= SIGNALS:
            self.signals.pop(next(iter(self.signals)))
        self.signals[path] = known
        return known

    def displacement(self, hypothesis: Hypothesis, weights: np.ndarray, index: int) -> np.ndarray:
        """(time,), µm: the weighted sum over the states of the hysteresis."""
        used = self.used(hypothesis, index)
        # The way of summing depends on the hypothesis alone, not on the cache, so results agree to the bit.
        if self.keeps_rows(hypothesis):
            x: np.ndarray = weights[used] @ self.rows(hypothesis, index)
            return x
        nominal, v = self.arranged(hypothesis, index).nominal, self.voltage(hypothesis, index)
        x = nominal.output(v, self.records[index].period_s, weights[: nominal.kept])
        if not hypothesis.history:
            return x
        remembered: np.ndarray = x + weights[used[nominal.kept :]] @ nominal.remembered(v)
        return remembered

    def zero(self, weights: np.ndarray, index: int) -> float:
        """The zero of one recording, µm."""
        return float(weights[len(weights) - len(self.records) + index])

    def where_stuck(self, hypothesis: Hypothesis, index: int, y: np.ndarray) -> np.ndarray:
        """Replace the output by the rest position wherever the mount is seen to stick."""
        rests = self.rests(hypothesis, index)
        return y if rests is None else np.where(rests.stuck, rests.at_um, y)

    def rests(self, hypothesis: Hypothesis, index: int) -> Rests | None:
        """Where the mount is seen to stick, if the hypothesis includes stiction; else None."""
        return self.records[index].rests if Stiction.name in hypothesis.names else None

    def behind_each(self, hypothesis: Hypothesis, weights: np.ndarray, index: int) -> list[Tensor]:
        """(1, time) each: the sum over the hysteresis, then the output of each effect behind it."""
        if self.keeps_rows(hypothesis):
            return self.signals_behind(hypothesis, weights, index)
        used = self.used(hypothesis, index)
        found = [torch.from_numpy(weights[used] @ self.rows(hypothesis, index))[None]]
        with torch.no_grad():
            for placed in self.arranged(hypothesis, index).after:
                found.append(placed(found[-1]))
        return found

    def output_of(
        self, hypothesis: Hypothesis, weights: np.ndarray, index: int, signals: Sequence[Tensor]
    ) -> np.ndarray:
        """(time,), µm: the output, given the signals of `behind_each`."""
        return self.where_stuck(hypothesis, index, signals[-1][0].numpy() + self.zero(weights, index))

    def directions(
        self, hypothesis: Hypothesis, rows: np.ndarray, index: int, signals: Sequence[Tensor]
    ) -> np.ndarray:
        """(rows, time): derivative of the output along hysteresis rows, (rows, time), at these signals."""
        found = torch.from_numpy(rows)
        with torch.no_grad():
            for placed, x in zip(self.arranged(hypothesis, index).after, signals[:-1], strict=True):
                found = placed.tangent(x, found)
        rests = self.rests(hypothesis, index)
        return found.numpy() if rests is None else np.where(rests.stuck, 0.0, found)

    def used(self, hypothesis: Hypothesis, index: int) -> np.ndarray:
        """Indices of the weights that belong to the rows of a recording."""
        kept = hypothesis.nominal.kept
        first = kept + hypothesis.history * index
        return np.concatenate([np.arange(kept), np.arange(first, first + hypothesis.history)])

    def slopes(
        self, hypothesis: Hypothesis, weights: np.ndarray, index: int
    ) -> dict[tuple[int, str], np.ndarray]:
        """Derivative of the output with respect to each modal parameter, (time,), in closed form, keyed by
        the member's index and the parameter's name."""
        places = [k for k, m in enumerate(hypothesis.members) if issubclass(m.effect, ModalEffect)]
        if not places:
            return {}
        found: dict[tuple[int, str], Tensor] = {}
        signals = self.signals_behind(hypothesis, weights, index)
        with torch.no_grad():
            for placed, x in zip(self.arranged(hypothesis, index).after, signals[:-1], strict=True):
                if found:
                    rows = placed.tangent(x, torch.cat(list(found.values())))
                    found = dict(zip(found, rows.split(1), strict=True))
                if isinstance(placed.effect, Modes):
                    found = placed.effect.slopes(x, placed.aux or ())  # type: ignore[arg-type]
        return {(places[part], name): row[0].numpy() for (part, name), row in found.items()}

    def moved(self, hypothesis: Hypothesis, rows: np.ndarray, index: int) -> np.ndarray:
        """Propagate rows, (rows, time), through the chain behind the hysteresis, linearised about rest."""
        directions, x = torch.from_numpy(rows), torch.zeros(1, rows.shape[1], dtype=torch.float64)
        with torch.no_grad():
            for placed in self.arranged(hypothesis, index).after:
                directions = placed.tangent(x, directions)
        return directions.numpy()

    def rows(self, hypothesis: Hypothesis, index: int) -> np.ndarray:
        """(rows, time): the states of the hysteresis, then the columns of the recording's history."""
        arranged = self.arranged(hypothesis, index)
        key, nominal = arranged.key, arranged.nominal
        if key not in self.remembered:
            v = self.voltage(hypothesis, index)
            rows = np.empty((nominal.kept + hypothesis.history, len(v)))
            nominal.fill(v, self.records[index].period_s, rows[: nominal.kept])
            if hypothesis.history:
                rows[nominal.kept :] = nominal.remembered(v)
            while (
                self.remembered and sum(r.nbytes for r in self.remembered.values()) + rows.nbytes > REMEMBERED
            ):
                self.remembered.pop(next(iter(self.remembered)))
            self.remembered[key] = rows
        return self.remembered[key]

    def voltage(self, hypothesis: Hypothesis, index: int) -> np.ndarray:
        """(time,), V: the voltage that drives the hysteresis."""
        before = hypothesis.alignment - self.late(hypothesis, index)
        v = torch.from_numpy(self.records[index].commanded(before))[None]
        with torch.no_grad():
            for placed in self.arranged(hypothesis, index).before:
                v = placed(v)
        reached: np.ndarray = v[0].numpy()
        return reached

    def late(self, hypothesis: Hypothesis, index: int) -> int:
        """Number of samples by which the driven rows are shifted in place of the voltage. Where a tick is one
        sample, a time-invariant simulation then need not be called again for another alignment."""
        record = self.records[index]
        at_ticks = record.tick_s == record.period_s
        return hypothesis.alignment if hypothesis.nominal.simulation and at_ticks else 0

    def keeps_rows(self, hypothesis: Hypothesis) -> bool:
        """Whether the rows of the hysteresis depend on no effect before it."""
        return not any(hypothesis.precedes(member.effect) for member in hypothesis.members)

    def bends(self, hypothesis: Hypothesis) -> bool:
        """Whether a nonlinear effect behind the hysteresis makes the readings nonlinear in the weights."""
        return any(
            not isinstance(one.effect, LinearEffect | Modes) for one in self.arranged(hypothesis, 0).after
        )

    def arranged(self, hypothesis: Hypothesis, index: int) -> Arrangement:
        """The cached arrangement of a hypothesis for one recording."""
        if (hypothesis, index) not in self.arrangements:
            if len(self.arrangements) >= MADE:
                self.arrangements.clear()
            nominal, effects = self.nominal(hypothesis, index), self.place(hypothesis, index)
            before = [p for p in effects if hypothesis.precedes(type(p.effect))]
            after = [p for p in effects if not hypothesis.precedes(type(p.effect))]
            shape, past = tuple(sorted(nominal.shape.items())), (hypothesis.remanent, nominal.start)
            states = (index, hypothesis.alignment, past, hypothesis.nominal.structure, shape)
            key = (*states, tuple(p.key for p in before))
            self.arrangements[hypothesis, index] = Arrangement(nominal, effects, before, after, key)
        return self.arrangements[hypothesis, index]

    def place(self, hypothesis: Hypothesis, index: int) -> list[Placed]:
        """Make the effects of an arrangement."""
        record = self.records[index]
        parts: list[tuple[Effect, tuple[object, ...], str]] = []
        modal = [m for m in hypothesis.members if issubclass(m.effect, ModalEffect)]
        for member in hypothesis.members:
            if issubclass(member.effect, Effect):
                values = member.values(index)
                key: tuple[object, ...] = (member.effect, record.period_s, member.aux, *values.items())
                parts.append(
                    (self.effect(key, partial(member.effect, record.period_s, **values)), key, member.aux)
                )
            elif modal and member is modal[-1]:
                each = [Part(m.effect, m.values(index), m.aux) for m in modal]  # type: ignore[arg-type]
                key = (record.period_s, *((p.effect, p.aux, *p.values.items()) for p in each))
                parts.append((self.effect(key, partial(Modes, record.period_s, each)), key, ""))
        keys: dict[Effect | None, tuple[object, ...]] = {effect: key for effect, key, _ in parts}
        found = []
        inputs = between_samples([effect for effect, _, _ in parts], hypothesis.held)
        for (effect, key, name), between in zip(parts, inputs, strict=True):
            key = (*key, between.hold)
            mine, block = self.block(effect, (*key, *keys.get(between.lag, ())), between)
            aux: Tensor | tuple[Tensor, ...] | None = (
                torch.from_numpy(record.aux[name])[None] if name else None
            )
            if isinstance(mine, Modes):
                aux = tuple(torch.from_numpy(record.aux[one])[None] for one in mine.aux_names)
            found.append(Placed(mine, aux, key, block))
        return found

    def effect(self, key: tuple[object, ...], make: Callable[[], Effect]) -> Effect:
        """The cached effect with given parameters."""
        if key not in self.made:
            if len(self.made) >= MADE:
                self.made.clear()
            self.made[key] = make()
        return self.made[key]

    def block(
        self, effect: Effect, key: tuple[object, ...], between: BetweenSamples
    ) -> tuple[Effect, DiscreteBlock | None]:
        """A cached copy of an effect with such an input, and what runs it if it has few states: to discretise
        takes longer than to run."""
        if key not in self.blocks:
            if len(self.blocks) >= MADE:
                self.blocks.clear()
            mine, block = copy(effect), None
            between.set_on(mine)
            if isinstance(mine, StateSpaceEffect):
                with torch.no_grad():
                    block = DiscreteBlock(without_idle_poles(mine.matrices()))
            self.blocks[key] = mine, block
        return self.blocks[key]

    def nominal(self, hypothesis: Hypothesis, index: int) -> HysteresisModel:
        """The hysteresis, including the effects that act inside it."""
        nominal = hypothesis.nominal
        for member in hypothesis.members:
            if issubclass(member.effect, InsideEffect):
                nominal = nominal.with_shape(member.values(index))
        if hypothesis.remanent and hypothesis.starts:
            nominal = replace(nominal, start=hypothesis.starts[index])
        if nominal.simulation:
            late = self.late(hypothesis, index)
            called = partial(nominal.simulation.output, self.records[index], hypothesis.alignment - late)
            nominal = replace(nominal, called=called, late=late)
        return nominal
