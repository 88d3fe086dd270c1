"""A hypothesis, which is a nominal hysteresis in a chain of effects, and the result of fitting it."""

from dataclasses import dataclass, replace

import numpy as np

from torchpi.diagnosis.hysteresis_model import HysteresisModel
from torchpi.stage.effects import EFFECTS
from torchpi.stage.effects.effect import Described, Effect, Parameters
from torchpi.stage.effects.inside import InsideEffect
from torchpi.stage.effects.mechanics.modal import ModalCoupling, ModalEffect, mode_numbers


@dataclass(frozen=True)
class EffectTerm:
    """An effect in a hypothesis, with its fitted parameters."""

    effect: type[Effect] | type[InsideEffect] | type[ModalEffect]
    shared: Parameters
    own: tuple[Parameters, ...] = ()
    """For each recording, the parameters that belong to it alone."""
    aux: str = ""
    """The auxiliary signal that drives it."""

    @property
    def form(self) -> tuple[str, ...]:
        """The names of the fitted parameters, which distinguish one form of an effect from another."""
        return tuple(sorted({*self.shared, *(name for own in self.own for name in own)}))

    @property
    def kind(self) -> tuple[object, ...]:
        """A key that all starting points of one form of an effect have in common."""
        return (self.effect, self.aux, self.form)

    def values(self, record: int) -> Parameters:
        return {**self.shared, **(self.own[record] if self.own else {})}

    def from_where(self, other: "EffectTerm") -> "EffectTerm":
        """Return this form of an effect, within its bounds, with the parameters it shares with another."""
        bounds = self.effect.quantities
        shared = {name: bounds[name].nearest(other.shared.get(name, v)) for name, v in self.shared.items()}
        return replace(self, shared=shared)


@dataclass(frozen=True)
class FreeParameter:
    """Where one fitted parameter is stored, its scale and its bounds."""

    member: int  # -1: the hysteresis itself
    name: str
    record: int | None
    log: bool
    scale: float
    low: float
    high: float
    step: float = 1e-4
    """Step of a finite difference."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A hysteresis model and effects, in the order of the chain."""

    nominal: HysteresisModel
    members: tuple[EffectTerm, ...] = ()
    alignment: int = 0
    """Whether y(k) answers the command of tick k (0) or of the tick before (1): a convention, not a delay."""
    held: bool = False
    """Whether the ceramic's displacement has a zero-order hold, as the command has: also a convention."""
    shape: tuple[str, ...] = ()
    """Names of the shape parameters of the hysteresis that are fitted."""
    remanent: bool = False
    """Whether each recording may start from its own unknown history."""
    starts: tuple[float, ...] = ()
    """With a history: the initial state of a Bouc–Wen hysteresis in each recording."""

    @property
    def history(self) -> int:
        """Number of columns that describe the history of each recording."""
        return self.nominal.remembers * self.remanent

    def plus(self, member: EffectTerm) -> "Hypothesis":
        """Return the hypothesis with one more effect, in the order of the chain."""
        order = {effect.name: i for i, effect in enumerate(EFFECTS)}
        members = sorted([*self.members, member], key=lambda m: order[m.effect.name])
        return replace(self, members=tuple(members))

    def precedes(self, effect: type[Described]) -> bool:
        """Whether an effect acts on the signal that drives the hysteresis, or the simulation."""
        outside = self.nominal.simulation
        return outside.precedes(effect) if outside else effect.before_hysteresis

    def on(
        self, nominal: HysteresisModel, shape: tuple[str, ...] = (), starts: tuple[float, ...] = ()
    ) -> "Hypothesis":
        """Return the same effects on another hysteresis, beside the same simulation."""
        if nominal.simulation is not self.nominal.simulation:
            nominal = replace(nominal, simulation=self.nominal.simulation).unreduced
        return replace(self, nominal=nominal, shape=shape, starts=starts)

    def without(self, name: str, aux: str | None = None) -> "Hypothesis":
        """Remove the effects of this name; if `aux` is given, only the one that takes that signal.

        Parameters of couplings that belong to a removed mode are removed with it.
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
    """Over all samples of each record, fitted and held out, (time,), µm."""
    train_rms: float
    heldout_rms: float
    on_a_bound: tuple[FreeParameter, ...]
    """The parameters that ended on a bound."""
    left_out_um2: np.ndarray
    """(cells,): mean squared residual of each cell, each stretch of time predicted by a fit to the others."""

    @property
    def bounded(self) -> tuple[str, ...]:
        """The names of the parameters that ended on a bound."""
        return tuple(slot.name for slot in self.on_a_bound)
