"""Evaluation of hypotheses on recordings: displacement, and its derivatives along rows and parameters."""

import pickle
from collections.abc import Sequence
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
from torchpi.operators.linear import Matrices
from torchpi.stage.effects.effect import Effect, LinearEffect, StateSpaceEffect, run, without_idle_poles
from torchpi.stage.effects.held import hold_first_block
from torchpi.stage.effects.inside import InsideEffect
from torchpi.stage.effects.mechanics.modal import ModalEffect
from torchpi.stage.effects.mechanics.modes import Modes, Part
from torchpi.stage.effects.mechanics.stiction import Stiction

SIGNALS = 60
"""Maximum number of cached signals inside the chain."""
MADE = 2000
"""Maximum number of cached effects with given parameters; also of cached placements and matrices."""
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
    matrices: Matrices | None
    """State-space matrices, for an effect with few states."""

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
        first = x[:, :1]
        response = self.effect(x - first) if self.matrices is None else run(x - first, self.matrices)
        moved: Tensor = response[0]
        return moved.add_(first)


class Chain:
    """Evaluates hypotheses on these recordings."""

    def __init__(self, records: Sequence[Record], weighting: Weighting | None = None) -> None:
        self.records = records
        self.weighting = weighting or Weighting.flat(records)
        """The weight of each coefficient."""
        self.remembered: dict[tuple[object, ...], np.ndarray] = {}
        self.signals: dict[tuple[object, ...], Tensor] = {}
        self.made: dict[tuple[object, ...], Effect] = {}
        self.matrices: dict[tuple[object, ...], Matrices] = {}
        self.linearised: Any = None
        """Sensitivities that many fits start from, with a key for the point at which they were taken."""
        self.placements: dict[tuple[Hypothesis, int], list[Placed]] = {}

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
        key = (self.key(hypothesis, index), weights.tobytes())
        path: list[tuple[object, ...]] = [key]
        y = self.signals.get(tuple(path))
        if y is None:
            y = self.signals[tuple(path)] = torch.from_numpy(self.displacement(hypothesis, weights, index))[
                None
            ]
        with torch.no_grad():
            for placed in self.after(hypothesis, index):
                path.append(placed.key)
                known = self.signals.get(tuple(path))
                if known is None:
                    known = placed(y)
                    self.remember(tuple(path), known)
                y = known
        return self.where_stuck(hypothesis, index, y[0].numpy() + self.zero(weights, index))

    def displacement(self, hypothesis: Hypothesis, weights: np.ndarray, index: int) -> np.ndarray:
        """(time,), µm: the weighted sum over the states of the hysteresis."""
        used = self.used(hypothesis, index)
        # The way of summing depends on the hypothesis alone, not on the cache, so results agree to the bit.
        if not any(hypothesis.precedes(member.effect) for member in hypothesis.members):
            x: np.ndarray = weights[used] @ self.rows(hypothesis, index)
            return x
        nominal, v = self.nominal(hypothesis, index), self.voltage(hypothesis, index)
        x = nominal.output(v, self.records[index].period_s, weights[: nominal.kept])
        if not hypothesis.history:
            return x
        remembered: np.ndarray = x + weights[used[nominal.kept :]] @ nominal.remembered(v)
        return remembered

    def remember(self, path: tuple[object, ...], signal: Tensor) -> None:
        """Cache a signal inside the chain: successive candidates act behind the same signals."""
        if len(self.signals) >= SIGNALS:
            self.signals.clear()
        self.signals[path] = signal

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
        used = self.used(hypothesis, index)
        found = [torch.from_numpy(weights[used] @ self.rows(hypothesis, index))[None]]
        with torch.no_grad():
            for placed in self.after(hypothesis, index):
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
            for placed, x in zip(self.after(hypothesis, index), signals[:-1], strict=True):
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
        x = torch.from_numpy(self.displacement(hypothesis, weights, index))[None]
        with torch.no_grad():
            for placed in self.after(hypothesis, index):
                if found:
                    rows = placed.tangent(x, torch.cat(list(found.values())))
                    found = dict(zip(found, rows.split(1), strict=True))
                if isinstance(placed.effect, Modes):
                    found = placed.effect.slopes(x, placed.aux or ())  # type: ignore[arg-type]
                x = placed(x)
        return {(places[part], name): row[0].numpy() for (part, name), row in found.items()}

    def moved(self, hypothesis: Hypothesis, rows: np.ndarray, index: int) -> np.ndarray:
        """Propagate rows, (rows, time), through the chain behind the hysteresis, linearised about rest."""
        directions, x = torch.from_numpy(rows), torch.zeros(1, rows.shape[1], dtype=torch.float64)
        with torch.no_grad():
            for placed in self.after(hypothesis, index):
                directions = placed.tangent(x, directions)
        return directions.numpy()

    def rows(self, hypothesis: Hypothesis, index: int) -> np.ndarray:
        """(rows, time): the states of the hysteresis, then the columns of the recording's history."""
        key = self.key(hypothesis, index)
        if key not in self.remembered:
            nominal = self.nominal(hypothesis, index)
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
            for placed in self.before(hypothesis, index):
                v = placed(v)
        reached: np.ndarray = v[0].numpy()
        return reached

    def late(self, hypothesis: Hypothesis, index: int) -> int:
        """Number of samples by which the driven rows are shifted in place of the voltage. Where a tick is one
        sample, a time-invariant simulation then need not be called again for another alignment."""
        record = self.records[index]
        at_ticks = record.tick_s == record.period_s
        return hypothesis.alignment if hypothesis.nominal.simulation and at_ticks else 0

    def key(self, hypothesis: Hypothesis, index: int) -> tuple[object, ...]:
        """Cache key of the states: everything that they depend on."""
        nominal = self.nominal(hypothesis, index)
        before = tuple(placed.key for placed in self.before(hypothesis, index))
        shape = tuple(sorted(nominal.shape.items()))
        past = (hypothesis.remanent, nominal.start)
        return (index, hypothesis.alignment, past, hypothesis.nominal.structure, shape, before)

    def before(self, hypothesis: Hypothesis, index: int) -> list[Placed]:
        """The effects that precede the hysteresis."""
        return [p for p in self.placed(hypothesis, index) if hypothesis.precedes(type(p.effect))]

    def after(self, hypothesis: Hypothesis, index: int) -> list[Placed]:
        """The effects that follow the hysteresis."""
        return [p for p in self.placed(hypothesis, index) if not hypothesis.precedes(type(p.effect))]

    def bends(self, hypothesis: Hypothesis) -> bool:
        """Whether a nonlinear effect behind the hysteresis makes the readings nonlinear in the weights."""
        return any(not isinstance(one.effect, LinearEffect | Modes) for one in self.after(hypothesis, 0))

    def placed(self, hypothesis: Hypothesis, index: int) -> list[Placed]:
        """Every effect outside the hysteresis, in the order of the chain."""
        if (hypothesis, index) not in self.placements:
            if len(self.placements) >= MADE:
                self.placements.clear()
            self.placements[hypothesis, index] = self.place(hypothesis, index)
        return self.placements[hypothesis, index]

    def place(self, hypothesis: Hypothesis, index: int) -> list[Placed]:
        """Make the effects that `placed` returns."""
        record = self.records[index]
        parts: list[tuple[Effect, tuple[object, ...], str]] = []
        modal = [m for m in hypothesis.members if issubclass(m.effect, ModalEffect)]
        for member in hypothesis.members:
            key: tuple[object, ...] = (
                member.effect,
                record.period_s,
                member.aux,
                *member.values(index).items(),
            )
            if issubclass(member.effect, Effect):
                if key not in self.made:
                    if len(self.made) >= MADE:
                        self.made.clear()
                    self.made[key] = member.effect(record.period_s, **member.values(index))
                # Copied, because the blocks before it determine what its input does between samples.
                parts.append((copy(self.made[key]), key, member.aux))
            elif modal and member is modal[-1]:
                each = [Part(m.effect, m.values(index), m.aux) for m in modal]  # type: ignore[arg-type]
                names = tuple((m.effect, m.aux, *m.values(index).items()) for m in modal)
                parts.append((Modes(record.period_s, each), names, ""))
        hold_first_block([effect for effect, _, _ in parts], hypothesis.held)
        found = []
        for effect, key, name in parts:
            aux: Tensor | tuple[Tensor, ...] | None = (
                torch.from_numpy(record.aux[name])[None] if name else None
            )
            if isinstance(effect, Modes):
                aux = tuple(torch.from_numpy(record.aux[one])[None] for one in effect.aux_names)
            found.append(Placed(effect, aux, (*key, effect.hold), self.discrete(effect, (*key, effect.hold))))
        return found

    def discrete(self, effect: Effect, key: tuple[object, ...]) -> Matrices | None:
        """Cached matrices of an effect with few states: computing them takes longer than using them."""
        if not isinstance(effect, StateSpaceEffect):
            return None
        if key not in self.matrices:
            if len(self.matrices) >= MADE:
                self.matrices.clear()
            with torch.no_grad():
                self.matrices[key] = without_idle_poles(effect.matrices())
        return self.matrices[key]

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
