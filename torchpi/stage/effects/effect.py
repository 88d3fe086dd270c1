"""Base classes of the physical effects that a stage may lack."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
import torch
from torch import Tensor, nn

from torchpi.errors import StageError
from torchpi.operators.base import Operator
from torchpi.operators.linear import Hold, LinearStream, Matrices, state_space
from torchpi.operators.quantity import Quantity
from torchpi.operators.relaxations import RelaxationsStream, relaxations

Block = Literal["amplifier", "actuator", "mechanics", "sensor"]
TimeScale = Literal["fast", "slow", "static", "any"]
Parameters = dict[str, float]


@dataclass(frozen=True)
class DataRange:
    """Ranges that the recordings span, from which the starts of a search for an effect are derived."""

    fs_hz: float
    """The highest sample rate."""
    duration_s: float
    """Duration of the longest recording."""
    low_v: float
    high_v: float
    max_rate_v_s: float
    """The 99.9th percentile of |u̇|."""
    low_um: float
    high_um: float
    aux: dict[str, float]
    """Standard deviation of each auxiliary signal."""
    peak_rate_v_s: float = 0.0
    """The largest |u̇|, which possibly only edges reach."""
    simulated: bool = False
    """Whether effects act on the output of a simulation of unknown structure, which may already have them
    with other parameters."""
    quickest_s: float = 0.0
    """The smallest σ_u/σ_u̇ of a recording; a relaxation that ends sooner looks like a delay."""

    @property
    def span_v(self) -> float:
        return self.high_v - self.low_v

    @property
    def span_um(self) -> float:
        return self.high_um - self.low_um


@dataclass(frozen=True)
class Needs:
    """What recordings must contain to be able to show an effect."""

    reversals: int = 0
    """Number of levels at which the voltage must reverse, in recordings that go up and come down."""
    recordings: int = 1
    """Minimum number of recordings."""
    pace: float = 1.0
    """Minimum ratio of the durations of the slowest and the fastest stroke, where the voltage never holds:
    with a single frequency the rate is a function of the voltage and of the amplitude."""


def parameter(unit: str, at_least: float, at_most: float, identity: float = 0.0) -> Any:
    """Declare a physical parameter in the body of an effect's class; arguments are those of `Quantity`."""
    return Quantity(unit, at_least, at_most, identity=identity)


class Described:
    """Description of a kind of effect for the search, the report and the files, whatever it acts on.

    The parameters are the quantities in the class body, together with those in `quantities`, which a class
    defines if it has many parameters, or others than its base class.
    """

    name: ClassVar[str]
    """Name in `diagnosis.json`."""
    block: ClassVar[Block]
    equation: ClassVar[str]
    """Equation in one line, with the symbols of the literature."""
    signature: ClassVar[str]
    """How the residual shows the effect, in one line."""
    quantities: ClassVar[dict[str, Quantity]]
    """Unit, physical bounds and identity of each parameter."""
    accepted: ClassVar[dict[str, Quantity]] = {}
    """Bounds of values that a user gives, where they are wider than those of a fit."""
    identity: ClassVar[Parameters]
    """The value of each parameter at which the effect is absent."""
    per_recording: ClassVar[tuple[str, ...]] = ()
    """Parameters that have a separate value in each recording, such as a phase."""
    relative: ClassVar[bool] = False
    """Whether only differences between recordings show it: one has the effect, the rest keep the identity."""
    before_hysteresis: ClassVar[bool] = False
    """Whether it acts on the voltage, not on a displacement."""
    takes_aux: ClassVar[bool] = False
    """Whether it takes an auxiliary signal as a second input."""
    jumps: ClassVar[tuple[str, ...]] = ()
    """Parameters in which the output jumps, so that only a finite step shows the direction of descent."""
    kinks: ClassVar[tuple[str, ...]] = ()
    """Parameters that decide which samples are affected; an infinitesimal step affects no others."""
    sticks: ClassVar[bool] = False
    """Whether small changes of the input do not move the output at rest, so that it has no slope there."""
    kinds: ClassVar[tuple[str, ...]] = ()
    """Parameters that select a variant of the effect; a start sets them, and they are not fitted."""
    hold: Hold | None = None
    """How the input of a dynamic block behaves between samples; None if the effect does not depend on it."""
    time_scale: ClassVar[TimeScale] = "any"
    """When it acts: "fast" with the rate of the input, "slow" over seconds and more, "static" at any rate."""
    needs: ClassVar[Needs] = Needs()
    unseen: ClassVar[str] = "these recordings show no sign of it within its bounds"
    """Why the effect is left out if `starts` returns nothing."""
    degenerate_with: ClassVar[tuple[str, ...]] = ()
    """Effects that in general cannot be told apart from this one by voltage and displacement alone."""
    left_by: ClassVar[tuple[str, ...]] = ()
    """Effects that leave a residual like that of this one if their equation does not quite match the rig."""
    alike_inside: ClassVar[tuple[str, ...]] = ()
    """Effects that look the same if a simulation of unknown structure may already have one of them."""
    commutes: ClassVar[bool] = False
    """Whether it has the same result before and behind any time-invariant block."""
    delays: ClassVar[bool] = False
    """Whether it delays the output by a roughly constant time, which looks like a convention of timing."""
    rings: ClassVar[bool] = False
    """Whether it has a mode of its own."""
    smooths: ClassVar[bool] = False
    """Whether it removes the steps of a held voltage."""
    read_off: ClassVar[bool] = False
    """Whether it is determined directly from the recorded readings instead of being fitted."""
    forms: ClassVar[tuple[str, ...]] = ()
    """Its alternative equations, if the cause is known but the equation is not; empty for only one."""
    form_of: ClassVar[Mapping[str, str]] = {}
    """The form that is in use when a parameter differs from its identity."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        own = {name: value for name, value in vars(cls).items() if isinstance(value, Quantity)}
        for name in own:
            delattr(cls, name)  # an instance has its value under this name
        others = vars(cls).get("quantities")
        inherited = getattr(cls, "quantities", {}) if others is None else {}
        cls.quantities = {**inherited, **own, **(others or {})}
        cls.identity = {name: quantity.identity for name, quantity in cls.quantities.items()}

    @classmethod
    def form(cls, values: Mapping[str, float]) -> str:
        """Return the form of `forms` that is in use; several are joined by " + ", and "" means none.

        Args:
            values: Parameters; the others are at their identity.
        """
        there = {cls.form_of[n] for n, v in values.items() if n in cls.form_of and v != cls.identity[n]}
        return " + ".join(form for form in cls.forms if form in there)

    @classmethod
    def starts_from(
        cls,
        seen: DataRange,
        residual: np.ndarray,  # (time,), µm, of one recording
        output: np.ndarray,  # (time,), µm, its readings
        fs_hz: float,
    ) -> list[Parameters]:
        """Return further starts, from the residual of a fit, for effects that a coarse grid misses."""
        return []

    @classmethod
    def line_hz(cls, values: Mapping[str, float]) -> float | None:
        """Return the frequency of the line that the effect generates whatever drives the stage, if any."""
        return None

    @classmethod
    def added_line_hz(cls, values: Mapping[str, float]) -> float | None:
        """Return the same frequency if the line is in the output however the stage moves, otherwise None."""
        return cls.line_hz(values)

    @classmethod
    def reached(cls, values: Mapping[str, float], seen: DataRange) -> bool:
        """Whether the recordings go far enough, or fast enough, to tell the effect from something else."""
        return True

    @classmethod
    def later(cls, values: Parameters, by_s: float) -> Parameters | None:
        """Return parameters with which the output is delayed by `by_s`; None if no parameter does that."""
        return None

    @classmethod
    def checked(cls, values: Mapping[str, float]) -> Parameters:
        """Return the values after checking that each is within its bounds.

        Raises:
            StageError: An unknown parameter, or a value out of bounds; names the parameter and its unit.
        """
        bounds = {**cls.quantities, **cls.accepted}
        for name, value in values.items():
            if name not in bounds:
                raise StageError(
                    f"{cls.name}: found the unknown parameter '{name}', expected {', '.join(cls.quantities)}"
                )
            # The identity may be a limit that no measured value takes, such as an infinite cutoff.
            if value != cls.identity[name]:
                bounds[name].check(name, value)
        return {name: float(value) for name, value in values.items()}


class Effect(Described, Operator):
    """One operator with a name, a place in the chain, and physical parameters.

    Built without values, the effect is the identity to the last bit, so a stage with the effect includes the
    stage without it as a special case. Parameters are scalar, float64 and trainable, each in the unit given
    in its name; a parameter at infinity has no gradient.

    Args:
        sample_period_s: T.
        values: Physical parameters; the others are at their identity.

    Raises:
        StageError: An unknown parameter, or a value out of its bounds; names the parameter and its unit.
    """

    def __init__(self, sample_period_s: float, **values: float) -> None:
        super().__init__()
        self.sample_period_s = sample_period_s
        given = self.checked(values)
        for name in self.quantities:
            value = torch.tensor(given.get(name, self.identity[name]), dtype=torch.float64)
            self.register_parameter(name, nn.Parameter(value, requires_grad=name not in self.kinds))

    def tangent(
        self,
        x: Tensor,  # (1, time), V or µm as the effect's input: the point of linearisation
        dx: Tensor,  # (directions, time), likewise V or µm
    ) -> Tensor:  # (directions, time)
        """Return the output's derivative along each direction of the input, from the de-energised state."""
        raise TypeError(f"{type(self).__name__} must define tangent(x, dx)")

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        """Return starting points of a fit: a coarse grid over the typical range that these data could show.

        Only the parameters named in an entry are fitted from there; none of them is at its identity.
        """
        raise TypeError(f"{cls.__name__} must define starts(seen)")

    def values(self) -> Parameters:
        """Return the present parameters."""
        return {name: self.get_parameter(name).item() for name in self.quantities}


class LinearEffect(Effect):
    """An effect that is linear in its input: its tangent is itself."""

    @torch.no_grad()
    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        dy: Tensor = self(dx)[0]
        return dy


class StateSpaceEffect(LinearEffect):
    """x⁺ = A x + B u, y = C x + D u: a linear effect of a few states."""

    order: ClassVar[int]

    def matrices(self) -> Matrices:
        """Return A (n, n), or (n,) if it is diagonal, B (n,), C (n,), D () at the present parameters."""
        raise TypeError(f"{type(self).__name__} must define matrices()")

    def initial_state(self, batch: int) -> Tensor:
        return torch.zeros(batch, self.order, dtype=torch.float64)

    def forward(
        self,
        x: Tensor,  # (batch, time)
        state: Tensor | None = None,  # (batch, n)
    ) -> tuple[Tensor, Tensor]:
        a, b, c, d = self.matrices()
        state = self.initial_state(len(x)) if state is None else state
        return (relaxations if a.ndim == 1 else state_space)(x, a, b, c, d, state)

    def stream(self) -> nn.Module:
        a, b, c, d = self.matrices()
        step = RelaxationsStream if a.ndim == 1 else LinearStream
        return step(a.flatten().tolist(), b.tolist(), c.tolist(), d.item())


def without_idle_poles(matrices: Matrices) -> Matrices:
    """Remove the states of a diagonal A that do not affect the output; the last state always stays."""
    a, b, c, d = matrices
    if a.ndim > 1:
        return matrices
    seen = c != 0
    seen[-1] = True
    return a[seen], b[seen], c[seen], d
