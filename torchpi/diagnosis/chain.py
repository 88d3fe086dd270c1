"""A hypothesis on recordings: its displacement, and how that moves with every number in it."""

import pickle
from collections.abc import Sequence
from functools import cached_property
from hashlib import sha256
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchpi.diagnosis.hypothesis import Hypothesis
from torchpi.diagnosis.nominal import Nominal
from torchpi.diagnosis.records import Record, Rests
from torchpi.stage.effects.effect import Effect
from torchpi.stage.effects.held import hold_first_block
from torchpi.stage.effects.inside import InsideEffect
from torchpi.stage.effects.mechanics.modal import ModalEffect
from torchpi.stage.effects.mechanics.modes import Modes, Part
from torchpi.stage.effects.mechanics.stiction import Stiction

REMEMBERED = 600_000_000
"""Bytes of rows that are kept: one candidate after another acts behind the same hysteresis."""


class Placed(NamedTuple):
    """An effect of one recording, and the auxiliary signal that it takes."""

    effect: Effect
    aux: Tensor | tuple[Tensor, ...] | None

    def __call__(self, x: Tensor) -> Tensor:
        # Only an effect that takes a second signal accepts one.
        y: Tensor = self.effect(x)[0] if self.aux is None else self.effect(x, None, self.aux)[0]
        return y


class Chain:
    """Evaluates hypotheses on these recordings."""

    def __init__(self, records: Sequence[Record]) -> None:
        self.records = records
        self.remembered: dict[tuple[object, ...], np.ndarray] = {}
        self.last: dict[int, tuple[tuple[object, ...], np.ndarray | None, np.ndarray]] = {}
        """By recording: the sum over the hysteresis that was made last, of which rows and weights."""

    @cached_property
    def packed(self) -> tuple[str, bytes]:
        """The recordings as they go to another process, and a key that tells them from others."""
        content = pickle.dumps(self.records)
        return sha256(content).hexdigest(), content

    @cached_property
    def span_v(self) -> float:
        """The largest travel of the command."""
        return max(float(np.ptp(record.u)) for record in self.records)

    def output(self, hypothesis: Hypothesis, weights: np.ndarray, index: int) -> np.ndarray:
        """(time,), µm, for one recording. The last weight is the sensor's zero, behind everything."""
        key = self.key(hypothesis, index)
        last_key, last_weights, last_x = self.last.get(index, ((), None, np.zeros(0)))
        if key == last_key and weights is last_weights:  # one candidate after another behind the same sum
            x = last_x
        elif key in self.remembered:
            x = weights[:-1] @ self.remembered[key][:-1]
            self.last[index] = key, weights, x
        else:
            nominal = self.nominal(hypothesis, index)
            x = nominal.output(self.voltage(hypothesis, index), self.records[index].period_s, weights[:-1])
        y = torch.from_numpy(x)[None]
        with torch.no_grad():
            for placed in self.after(hypothesis, index):
                y = placed(y)
        return self.told(hypothesis, index, y[0].numpy() + weights[-1])

    def told(self, hypothesis: Hypothesis, index: int, y: np.ndarray) -> np.ndarray:
        """An output, and where the mount is seen to stick the place at which it rests."""
        rests = self.rests(hypothesis, index)
        return y if rests is None else np.where(rests.stuck, rests.at_um, y)

    def rests(self, hypothesis: Hypothesis, index: int) -> Rests | None:
        """Where the mount is seen to stick, if the hypothesis has it stick."""
        return self.records[index].rests if Stiction.name in hypothesis.names else None

    def output_and_directions(
        self, hypothesis: Hypothesis, weights: np.ndarray, index: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """The output, and how it moves with each weight, (weights, time)."""
        rows = self.rows_and_zero(hypothesis, index)
        x, directions = torch.from_numpy(weights[:-1] @ rows[:-1])[None], torch.from_numpy(rows)
        with torch.no_grad():
            for placed in self.after(hypothesis, index):
                directions = placed.effect.tangent(x, directions)
                x = placed(x)
        moves = directions.numpy()
        moves[-1] = 1.0  # the zero lies behind all effects
        rests = self.rests(hypothesis, index)
        if rests is not None:
            moves = np.where(rests.stuck, 0.0, moves)
        return self.told(hypothesis, index, x[0].numpy() + weights[-1]), moves

    def slopes(
        self, hypothesis: Hypothesis, weights: np.ndarray, index: int
    ) -> dict[tuple[int, str], np.ndarray]:
        """How the output moves with each number of its modes, (time,), in closed form; under the member's
        place and the number's name."""
        places = [k for k, m in enumerate(hypothesis.members) if issubclass(m.effect, ModalEffect)]
        if not places:
            return {}
        found: dict[tuple[int, str], Tensor] = {}
        x = torch.from_numpy(weights[:-1] @ self.rows(hypothesis, index))[None]
        with torch.no_grad():
            for placed in self.after(hypothesis, index):
                if found:
                    rows = placed.effect.tangent(x, torch.cat(list(found.values())))
                    found = dict(zip(found, rows.split(1), strict=True))
                if isinstance(placed.effect, Modes):
                    found = placed.effect.slopes(x, placed.aux or ())  # type: ignore[arg-type]
                x = placed(x)
        return {(places[part], name): row[0].numpy() for (part, name), row in found.items()}

    def moved(self, hypothesis: Hypothesis, rows: np.ndarray, index: int) -> np.ndarray:
        """What the chain after the hysteresis makes of rows, (rows, time), about rest."""
        directions, x = torch.from_numpy(rows), torch.zeros(1, rows.shape[1], dtype=torch.float64)
        with torch.no_grad():
            for placed in self.after(hypothesis, index):
                directions = placed.effect.tangent(x, directions)
        return directions.numpy()

    def rows(self, hypothesis: Hypothesis, index: int) -> np.ndarray:
        """The states of the hysteresis, (states, time)."""
        return self.rows_and_zero(hypothesis, index)[:-1]

    def rows_and_zero(self, hypothesis: Hypothesis, index: int) -> np.ndarray:
        """The same and a row of ones, (weights, time)."""
        key = self.key(hypothesis, index)
        if key not in self.remembered:
            nominal = self.nominal(hypothesis, index)
            v = self.voltage(hypothesis, index)
            rows = np.ones((nominal.kept + 1, len(v)))
            nominal.fill(v, self.records[index].period_s, rows[:-1])
            while (
                self.remembered and sum(r.nbytes for r in self.remembered.values()) + rows.nbytes > REMEMBERED
            ):
                self.remembered.pop(next(iter(self.remembered)))
            self.remembered[key] = rows
        return self.remembered[key]

    def voltage(self, hypothesis: Hypothesis, index: int) -> np.ndarray:
        """What drives the hysteresis, (time,), V."""
        v = torch.from_numpy(self.records[index].commanded(hypothesis.alignment))[None]
        with torch.no_grad():
            for placed in self.before(hypothesis, index):
                v = placed(v)
        return v[0].numpy()  # type: ignore[no-any-return]

    def key(self, hypothesis: Hypothesis, index: int) -> tuple[object, ...]:
        """What the states depend on."""
        nominal = self.nominal(hypothesis, index)
        before = tuple((p.effect.name, *p.effect.values().items()) for p in self.before(hypothesis, index))
        shape = tuple(sorted(nominal.shape.items()))
        return (index, hypothesis.alignment, nominal.structure, shape, before)

    def before(self, hypothesis: Hypothesis, index: int) -> list[Placed]:
        """What precedes the hysteresis."""
        return [p for p in self.placed(hypothesis, index) if p.effect.before_hysteresis]

    def after(self, hypothesis: Hypothesis, index: int) -> list[Placed]:
        """What follows the hysteresis."""
        return [p for p in self.placed(hypothesis, index) if not p.effect.before_hysteresis]

    def placed(self, hypothesis: Hypothesis, index: int) -> list[Placed]:
        """Every effect outside the hysteresis, in the order of the chain."""
        record = self.records[index]
        found: list[Placed] = []
        modal = [m for m in hypothesis.members if issubclass(m.effect, ModalEffect)]
        for member in hypothesis.members:
            if issubclass(member.effect, Effect):
                aux = torch.from_numpy(record.aux[member.aux])[None] if member.aux else None
                found.append(Placed(member.effect(record.period_s, **member.values(index)), aux))
            elif modal and member is modal[-1]:
                parts = [Part(m.effect, m.values(index), m.aux) for m in modal]  # type: ignore[arg-type]
                modes = Modes(record.period_s, parts)
                signals = tuple(torch.from_numpy(record.aux[name])[None] for name in modes.aux_names)
                found.append(Placed(modes, signals))
        hold_first_block([placed.effect for placed in found], hypothesis.held)
        return found

    def nominal(self, hypothesis: Hypothesis, index: int) -> Nominal:
        """The hysteresis with the effects inside it."""
        nominal = hypothesis.nominal
        for member in hypothesis.members:
            if issubclass(member.effect, InsideEffect):
                nominal = nominal.with_shape(member.values(index))
        return nominal
