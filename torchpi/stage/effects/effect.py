"""What every piece of physics that a stage may lack has in common."""

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
    """What the recordings span: it sets where a search for an effect may begin."""

    fs_hz: float
    """The highest sample rate."""
    duration_s: float
    """Of the longest recording."""
    low_v: float
    high_v: float
    max_rate_v_s: float
    """The 99.9th percentile of |u̇|."""
    low_um: float
    high_um: float
    aux: dict[str, float]
    """Standard deviation of each auxiliary signal."""
    peak_rate_v_s: float = 0.0
    """The largest |u̇|, which only edges may reach."""
    simulated: bool = False
    """Whether effects act on the output of a simulation whose inside is not known: it may have them already,
    with other parameters."""
    repeats: bool = False
    """Whether the voltage of every recording repeats: what does not repeat with it stands apart."""
    quickest_s: float = 0.0
    """σ_u/σ_u̇, where the voltage moves quickest: what is over sooner looks late."""

    @property
    def span_v(self) -> float:
        return self.high_v - self.low_v

    @property
    def span_um(self) -> float:
        return self.high_um - self.low_um


@dataclass(frozen=True)
class Needs:
    """What recordings must have before they can show an effect at all."""

    reversals: int = 0
    """A voltage that goes up and comes down: levels at which it turns round."""
    recordings: int = 1
    """So many recordings."""
    pace: float = 1.0
    """Strokes of which one takes so many times as long as another: with one frequency the rate is a function
    of the voltage and of the amplitude."""


def parameter(unit: str, at_least: float, at_most: float, identity: float = 0.0) -> Any:
    """A physical parameter in the body of an effect's class: arguments are those of `Quantity`."""
    return Quantity(unit, at_least, at_most, identity=identity)


class Described:
    """What the search, the report and the files need of a kind of effect, whatever it acts on.

    The parameters are the quantities in a class's body, and those of `quantities` beside them, where there
    are many, or others than in the class that it is derived from.
    """

    name: ClassVar[str]
    """As in `diagnosis.json`."""
    block: ClassVar[Block]
    equation: ClassVar[str]
    """One line, with the letters of the literature."""
    signature: ClassVar[str]
    """How the residual shows it, in one line."""
    quantities: ClassVar[dict[str, Quantity]]
    """Unit, physical bounds and identity of each parameter."""
    accepted: ClassVar[dict[str, Quantity]] = {}
    """Bounds of a given value, where they are wider than those that a fit stays in."""
    identity: ClassVar[Parameters]
    """The value of each parameter at which the effect is not there."""
    per_recording: ClassVar[tuple[str, ...]] = ()
    """Parameters that are another number in each recording, such as a phase."""
    relative: ClassVar[bool] = False
    """Whether it shows as a difference alone: one recording has it, and the rest keep the identity."""
    before_hysteresis: ClassVar[bool] = False
    """Whether it acts on the voltage, not on a displacement."""
    takes_aux: ClassVar[bool] = False
    """Whether it takes an auxiliary signal as a second input."""
    jumps: ClassVar[tuple[str, ...]] = ()
    """Parameters in which the output jumps: only a finite step shows which way to go."""
    kinks: ClassVar[tuple[str, ...]] = ()
    """Parameters that decide which samples an effect touches: an infinitesimal step touches no others."""
    sticks: ClassVar[bool] = False
    """Whether nothing small moves it: at rest its output has no slope."""
    kinds: ClassVar[tuple[str, ...]] = ()
    """Parameters that choose between kinds of the effect: a start sets them, and they are not fitted."""
    walk: ClassVar[tuple[str, ...]] = ()
    """Numbers of a recording that are places on a random walk, one after another."""
    hold: Hold | None = None
    """For a dynamic block what its input does between samples; None for an effect that need not know."""
    time_scale: ClassVar[TimeScale] = "any"
    """When it acts: "fast" with the rate of the input, "slow" over seconds and more, "static" at any rate."""
    needs: ClassVar[Needs] = Needs()
    unseen: ClassVar[str] = "these recordings show nothing within its bounds"
    """Why it is left out where `starts` returns nothing."""
    degenerate_with: ClassVar[tuple[str, ...]] = ()
    """Effects that voltage and displacement alone cannot split from it in general."""
    left_by: ClassVar[tuple[str, ...]] = ()
    """Effects whose remainder looks like this one where their equation is not quite the rig's."""
    alike_inside: ClassVar[tuple[str, ...]] = ()
    """Effects that look the same where a simulation whose inside is not known may have one of them."""
    commutes: ClassVar[bool] = False
    """Whether it does the same before and behind anything that does not change with time."""
    delays: ClassVar[bool] = False
    """Whether it makes the output late by about one time: a convention of timing looks the same."""
    rings: ClassVar[bool] = False
    """Whether it has a mode of its own."""
    smooths: ClassVar[bool] = False
    """Whether it leaves no steps in a held voltage."""
    read_off: ClassVar[bool] = False
    """Whether it is read off the recorded readings, not fitted."""
    forms: ClassVar[tuple[str, ...]] = ()
    """Its equations, where the cause is known and the equation is not; empty for one equation only."""
    form_of: ClassVar[Mapping[str, str]] = {}
    """The form that each parameter brings in when it leaves its identity."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        own = {name: value for name, value in vars(cls).items() if isinstance(value, Quantity)}
        for name in own:
            delattr(cls, name)  # an instance has the number there
        others = vars(cls).get("quantities")
        inherited = getattr(cls, "quantities", {}) if others is None else {}
        cls.quantities = {**inherited, **own, **(others or {})}
        cls.identity = {name: quantity.identity for name, quantity in cls.quantities.items()}

    @classmethod
    def form(cls, values: Mapping[str, float]) -> str:
        """The form in use, of `forms`, joined by " + " where there are several; "" where there is none.

        Args:
            values: Parameters, the rest as in the identity.
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
        """Further starts, from what a fit has left: for effects that no coarse grid finds."""
        return []

    @classmethod
    def extrapolates(cls, values: Mapping[str, float]) -> bool:
        """Whether these numbers tell what comes after the samples that they were fitted to."""
        return True

    @classmethod
    def line_hz(cls, values: Mapping[str, float]) -> float | None:
        """The frequency of a line that it has of itself, whatever drives the stage, if it has one."""
        return None

    @classmethod
    def added_line_hz(cls, values: Mapping[str, float]) -> float | None:
        """The same where the output has that line, however the stage moves."""
        return cls.line_hz(values)

    @classmethod
    def reached(cls, values: Mapping[str, float], seen: DataRange) -> bool:
        """Whether recordings drive it as far, or as quickly, as it takes to tell it from something else."""
        return True

    @classmethod
    def later(cls, values: Parameters, by_s: float) -> Parameters | None:
        """Parameters with which the output is the same, so much later; None where no parameter does that."""
        return None

    @classmethod
    def checked(cls, values: Mapping[str, float]) -> Parameters:
        """The values, each within its bounds.

        Raises:
            StageError: An unknown parameter, or a value out of bounds; names the parameter and its unit.
        """
        bounds = {**cls.quantities, **cls.accepted}
        for name, value in values.items():
            if name not in bounds:
                raise StageError(
                    f"{cls.name}: found the unknown parameter '{name}', expected {', '.join(cls.quantities)}"
                )
            # The identity itself may be a limit, such as an infinite cutoff, that no measured value takes.
            if value != cls.identity[name]:
                bounds[name].check(name, value)
        return {name: float(value) for name, value in values.items()}


class Effect(Described, Operator):
    """One operator with a name, a place in the chain, and physical parameters.

    Built without values it is the identity, to the last bit: a stage with the effect contains the stage
    without it. Parameters are scalar, float64, trainable, each in the unit of its name; one at infinity has
    no gradient.

    Args:
        sample_period_s: T.
        values: Physical parameters, the rest as in the identity.

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
        x: Tensor,  # (1, time), V or µm as the effect's input: where it is taken
        dx: Tensor,  # (directions, time), likewise V or µm
    ) -> Tensor:  # (directions, time)
        """How the output moves when the input moves along each direction, from the de-energised state."""
        raise TypeError(f"{type(self).__name__} must define tangent(x, dx)")

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        """Where a fit may begin: a coarse grid over the typical range, all that these data could show.

        Only the parameters named in an entry are fitted from there; none is at its identity.
        """
        raise TypeError(f"{cls.__name__} must define starts(seen)")

    def values(self) -> Parameters:
        """The present parameters."""
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
        """A (n, n), or (n,) where it is diagonal, B (n,), C (n,), D () at the present parameters."""
        raise TypeError(f"{type(self).__name__} must define matrices()")

    def initial_state(self, batch: int) -> Tensor:
        return torch.zeros(batch, self.order, dtype=torch.float64)

    def forward(
        self,
        x: Tensor,  # (batch, time)
        state: Tensor | None = None,  # (batch, n)
    ) -> tuple[Tensor, Tensor]:
        return run(x, self.matrices(), self.initial_state(len(x)) if state is None else state)

    def stream(self) -> nn.Module:
        a, b, c, d = self.matrices()
        step = RelaxationsStream if a.ndim == 1 else LinearStream
        return step(a.flatten().tolist(), b.tolist(), c.tolist(), d.item())


def run(
    x: Tensor,  # (batch, time)
    matrices: Matrices,
    state: Tensor | None = None,  # (batch, n), zeros by default
) -> tuple[Tensor, Tensor]:
    """Output and state of x⁺ = A x + B u, y = C x + D u, with A (n, n), or (n,) where it is diagonal."""
    a, b, c, d = matrices
    state = b.new_zeros(len(x), len(b)) if state is None else state
    return (relaxations if a.ndim == 1 else state_space)(x, a, b, c, d, state)


def without_idle_poles(matrices: Matrices) -> Matrices:
    """The same output without the states of a diagonal A that it does not see; one stays."""
    a, b, c, d = matrices
    if a.ndim > 1:
        return matrices
    seen = c != 0
    seen[-1] = True
    return a[seen], b[seen], c[seen], d
