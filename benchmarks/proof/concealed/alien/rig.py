"""The chain that alien effects act in, and what a form of an effect is.

command → converter → (hold) → amplifier → hysteresis → actuator → mechanics → mount → sensor → reading
    → (noise) → code
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from concealed.alien.hysteresis import Truth
from concealed.plant.physics import Array
from concealed.plant.rig import Run

PLACES = (
    "converter",
    "amplifier",
    "hysteresis",
    "actuator",
    "mechanics",
    "mount",
    "sensor",
    "reading",
    "code",
)


@dataclass(frozen=True)
class Rig:
    """A plain plant and how it is sampled; `late` where a reading is taken before the tick's write."""

    truth: Truth
    other: Truth
    fs_hz: float
    fine: int  # steps of the simulation in a tick
    lower_v: float
    upper_v: float
    range_um: float
    sign: float  # of the gain
    noise_um: float
    late: bool
    seed: int
    samples: int

    @property
    def span_v(self) -> float:
        """The larger of both limits, V."""
        return max(self.upper_v, -self.lower_v)

    @property
    def timing(self) -> str:
        """The convention by which readings are taken, as the labels name it."""
        return "before_write" if self.late else "end_of_hold"

    @property
    def dt(self) -> float:
        """Step of the simulation, s."""
        return 1 / (self.fs_hz * self.fine)

    @property
    def duration_s(self) -> float:
        """Of one recording."""
        return self.samples / self.fs_hz


@dataclass(frozen=True)
class At:
    """Where a signal is when an effect acts on it."""

    rig: Rig
    run: Run
    dt: float  # of the signal, s
    time_s: Array = field(default_factory=lambda: np.zeros(0))  # of readings only

    def rng(self, salt: int) -> np.random.Generator:
        """Chance that belongs to the recording."""
        return np.random.default_rng([self.rig.seed, self.run.number, salt])


Act = Callable[[Array, At], Array]


@dataclass(frozen=True)
class Drawn:
    """A form with everything drawn but its strength, which the severity decides."""

    act: Callable[[Array, At, float], Array]
    low: float
    high: float
    start: float
    parameters: Callable[[float], dict[str, tuple[float, str]]] = lambda s: {}


@dataclass(frozen=True)
class Form:
    """One equation of an effect, from literature.

    `foreign` where torchpi has no such form; `foreseeable` where the command
    determines what it does; `near` are names on the list that are truly in it.
    """

    effect: str
    form: str
    source: str
    place: str
    draw: Callable[[np.random.Generator, Rig, Sequence[Run]], Drawn]
    foreign: bool
    foreseeable: bool
    near: frozenset[str]


@dataclass(frozen=True)
class Forms:
    """A registry; `add` is a decorator for the function that draws a form."""

    all: list[Form] = field(default_factory=list)

    def add(
        self,
        effect: str,
        form: str,
        source: str,
        place: str,
        *near: str,
        foreign: bool = True,
        foreseeable: bool = True,
    ) -> Callable[[Callable], Callable]:
        """Put a form on the list."""

        def register(draw: Callable) -> Callable:
            self.all.append(Form(effect, form, source, place, draw, foreign, foreseeable, frozenset(near)))
            return draw

        return register

    def of(self, effect: str) -> list[Form]:
        """The forms of an effect."""
        return [form for form in self.all if form.effect == effect]

    def effects(self) -> list[str]:
        """The effects, in the order in which they were added."""
        return list(dict.fromkeys(form.effect for form in self.all))


Plain = dict[int, dict[str, Array]]
Placed = Sequence[tuple[str, Act]]


def simulate(
    rig: Rig, acts: Placed, run: Run, time_s: Array, plain: Plain | None = None, noise_um: Array | float = 0.0
) -> Array:
    """Readings, µm, at `time_s`, from the de-energised state; a history is played, not read.

    `plain` keeps what the plain chain has before each place of each run, so that one effect is simulated from
    its own place on.
    """
    kept = {} if plain is None else plain.setdefault(run.number, {})
    if plain is not None and not kept:
        kept["converter"] = run.u
        _along(rig, (), run, time_s, 0, kept, 0.0)
    start = min((PLACES.index(place) for place, _ in acts), default=0) if kept else 0
    return _along(rig, acts, run, time_s, start, dict(kept) or {"converter": run.u}, noise_um)


def _along(
    rig: Rig,
    acts: Placed,
    run: Run,
    time_s: Array,
    start: int,
    kept: dict[str, Array],
    noise_um: Array | float,
) -> Array:
    """From the signal before place `start` to the readings; keeps what comes before each place."""
    x = kept[PLACES[start]]
    for number, place in enumerate(PLACES[start:], start):
        at = At(rig, run, 1 / rig.fs_hz if place in ("converter", "reading", "code") else rig.dt, time_s)
        here = [act for where, act in acts if where == place]
        if place == "hysteresis":
            base = rig.truth.respond(x)
            # Several effects inside the hysteresis add what each changes.
            x = rig.sign * (base + sum(act(x, at) - base for act in here))
        else:
            for act in here:
                x = act(x, at)
        if place == "converter":
            x = np.repeat(x, rig.fine)
        elif place == "sensor":
            x = _read(rig, run, x, time_s)
        elif place == "reading":
            x = x + noise_um
        if number + 1 < len(PLACES):
            kept[PLACES[number + 1]] = x
    return x


def _read(rig: Rig, run: Run, x: Array, time_s: Array) -> Array:
    """The fine signal at the moments of the readings: after the hold of a tick, or before its write."""
    ticks = time_s * rig.fs_hz + run.history + (0 if rig.late else 1)
    place = ticks * rig.fine - 1  # the last fine step before that moment
    return np.interp(place, np.arange(x.size), x)
