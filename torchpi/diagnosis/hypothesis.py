"""A hypothesis: a nominal hysteresis in a chain of effects, and what a fit makes of it."""

from dataclasses import dataclass, replace

import numpy as np

from torchpi.diagnosis.hysteresis_model import HysteresisModel
from torchpi.stage.effects import EFFECTS
from torchpi.stage.effects.effect import Described, Effect, Parameters
from torchpi.stage.effects.inside import InsideEffect
from torchpi.stage.effects.mechanics.modal import ModalCoupling, ModalEffect, mode_numbers


@dataclass(frozen=True)
class EffectTerm:
    """An effect in a hypothesis, with the parameters that are fitted."""

    effect: type[Effect] | type[InsideEffect] | type[ModalEffect]
    shared: Parameters
    own: tuple[Parameters, ...] = ()
    """For each recording the parameters that are its own."""
    aux: str = ""
    """The auxiliary signal that it takes."""

    @property
    def form(self) -> tuple[str, ...]:
        """The numbers that are fitted tell one form of an effect from another."""
        return tuple(sorted({*self.shared, *(name for own in self.own for name in own)}))

    @property
    def kind(self) -> tuple[object, ...]:
        """What all starts of one form of an effect have in common."""
        return (self.effect, self.aux, self.form)

    def values(self, record: int) -> Parameters:
        return {**self.shared, **(self.own[record] if self.own else {})}

    def from_where(self, other: "EffectTerm") -> "EffectTerm":
        """This form of an effect, with the numbers of another form that it has too."""
        return replace(self, shared={name: other.shared.get(name, v) for name, v in self.shared.items()})


@dataclass(frozen=True)
class FreeParameter:
    """Where one fitted number lives."""

    member: int  # -1: the nominal's own shape
    name: str
    record: int | None
    log: bool
    scale: float
    low: float
    high: float
    step: float = 1e-4
    """Of a finite difference."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """HysteresisModel and effects, in the order of the chain."""

    nominal: HysteresisModel
    members: tuple[EffectTerm, ...] = ()
    alignment: int = 0
    """Whether y(k) sees the command of tick k (0) or of the tick before (1): a convention, not a delay."""
    held: bool = False
    """Whether the displacement of the ceramic is stepped, as the command is: a convention as well."""
    shape: tuple[str, ...] = ()
    """Parameters of the nominal's shape that are fitted."""
    remanent: bool = False
    """Whether each recording may start from a history of its own."""
    starts: tuple[float, ...] = ()
    """With a history, where the state of a Bouc–Wen hysteresis starts in each recording."""

    @property
    def history(self) -> int:
        """Columns of what each recording may remember."""
        return self.nominal.remembers * self.remanent

    def plus(self, member: EffectTerm) -> "Hypothesis":
        """With one more effect, in the order of the chain."""
        order = {effect.name: i for i, effect in enumerate(EFFECTS)}
        members = sorted([*self.members, member], key=lambda m: order[m.effect.name])
        return replace(self, members=tuple(members))

    def precedes(self, effect: type[Described]) -> bool:
        """Whether an effect acts on what drives the hysteresis, or the simulation."""
        outside = self.nominal.simulation
        return outside.precedes(effect) if outside else effect.before_hysteresis

    def on(
        self, nominal: HysteresisModel, shape: tuple[str, ...] = (), starts: tuple[float, ...] = ()
    ) -> "Hypothesis":
        """The same effects on another hysteresis, beside the same simulation."""
        if nominal.simulation is not self.nominal.simulation:
            nominal = replace(nominal, simulation=self.nominal.simulation).unreduced
        return replace(self, nominal=nominal, shape=shape, starts=starts)

    def without(self, name: str, aux: str | None = None) -> "Hypothesis":
        """Without what has this name; of what takes a signal, only that of one, if it is given.

        What couplings say of a mode goes with the mode.
        """
        kept = [m for m in self.members if m.effect.name != name or aux not in (None, m.aux)]
        there = ModalCoupling.of_modes(mode_numbers(m.effect for m in kept))
        members = tuple(
            replace(m, shared={n: v for n, v in m.shared.items() if n in there})
            if m.effect is ModalCoupling
            else m
            for m in kept
        )
        return replace(self, members=members)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(member.effect.name for member in self.members)


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted hypothesis."""

    hypothesis: Hypothesis
    weights: np.ndarray
    slots: tuple[FreeParameter, ...]
    theta: np.ndarray
    residuals: tuple[np.ndarray, ...]
    """(time,) for each record, train and held out, µm."""
    train_rms: float
    heldout_rms: float
    on_a_bound: tuple[FreeParameter, ...]
    """Those of the slots that ended there."""
    left_out_um2: np.ndarray
    """(cells,): mean square of each cell, each stretch of time predicted by the fit to the others."""

    @property
    def bounded(self) -> tuple[str, ...]:
        """The names of what ended on a bound."""
        return tuple(slot.name for slot in self.on_a_bound)
