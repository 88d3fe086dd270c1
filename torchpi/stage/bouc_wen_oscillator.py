"""The oscillator with Bouc–Wen hysteresis: a force in, the displacement of one mode out.

    force → mode ⇄ hysteresis of its own displacement → displacement

`torchpi.operators.bouc_wen_oscillator` gives the equations. The parameters are physical quantities in
float64, so one set serves any sample rate.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from torchpi.errors import StageError, is_positive, is_whole
from torchpi.operators.bouc_wen_oscillator import (
    BETWEEN_SAMPLES,
    BetweenSamples,
    BoucWenParameters,
    bouc_wen_oscillator,
    half_width,
    interpolation_taps,
)
from torchpi.operators.compiled import in_threads
from torchpi.stage.file import SavedStage

STEPS = 20
"""Integration steps per sample; error 2e-5 of the rms for the nonlinear benchmark's oscillator at 750 Hz."""
MOST_STEPS = 10_000
UM_PER_M = 1e6
PERIODIC = 1e-9
"""Share of the largest displacement; successive periods that differ by less are in steady state."""
MOST_PERIODS = 1000


@dataclass
class OscillatorState:
    """State of one run after a sample."""

    before: np.ndarray  # (2 half widths,), N, the last samples of the force
    motion: np.ndarray = field(
        default_factory=lambda: np.zeros(3)
    )  # displacement, velocity, hysteretic force
    past: int = 0


class BoucWenOscillator(SavedStage):
    """A mode whose restoring force has Bouc–Wen hysteresis.

    Args:
        sample_rate_hz: Sample rate of force and displacement.
        parameters: Values by the names of `BoucWenParameters`, in SI units. If the input is a voltage,
            newtons stand for volts.
        between: How the force varies between its samples: `band_limited`, `linear`, or `held`.
        steps: Integration steps per sample.
        offset_um: Reading of the sensor at rest.

    Raises:
        StageError: A parameter that is missing or has no physical meaning.
    """

    SCHEMA, VERSION, KIND = "torchpi Bouc-Wen oscillator", 1, "a Bouc–Wen oscillator"

    def __init__(
        self,
        sample_rate_hz: float,
        parameters: Mapping[str, float],
        between: BetweenSamples = "band_limited",
        steps: int = STEPS,
        offset_um: float = 0.0,
    ) -> None:
        super().__init__()
        if not is_positive(sample_rate_hz):
            raise StageError(f"sample_rate_hz: found {sample_rate_hz}, expected a positive number")
        if between not in BETWEEN_SAMPLES:
            raise StageError(f"between: found {between!r}, expected one of {', '.join(BETWEEN_SAMPLES)}")
        if not is_whole(steps) or not 1 <= steps <= MOST_STEPS:
            raise StageError(f"steps: found {steps!r}, expected a whole number from 1 to {MOST_STEPS}")
        if not math.isfinite(offset_um):
            raise StageError(f"offset_um: found {offset_um}, expected a finite number")
        if set(parameters) != set(BoucWenParameters._fields):
            expected = ", ".join(BoucWenParameters._fields)
            raise StageError(f"parameters: found {', '.join(sorted(parameters))}, expected {expected}")
        self.sample_rate_hz, self.between, self.steps = float(sample_rate_hz), between, steps
        self._taps = interpolation_taps(between, steps)
        for name in BoucWenParameters._fields:
            value = float(parameters[name])
            _check(name, value)
            setattr(self, name, nn.Parameter(torch.tensor(value, dtype=torch.float64)))
        self.register_buffer("offset_um", torch.tensor(offset_um, dtype=torch.float64))

    @property
    def values(self) -> BoucWenParameters:
        """The parameters as plain numbers."""
        return BoucWenParameters(*(getattr(self, name).item() for name in BoucWenParameters._fields))

    @property
    def frequency_hz(self) -> float:
        """Natural frequency of the undamped mode at small amplitude."""
        p = self.values
        return math.sqrt((p.stiffness_n_m + p.hysteretic_stiffness_n_m) / p.mass_kg) / (2 * math.pi)

    @property
    def damping_ratio(self) -> float:
        """Damping ratio of the mode at small amplitude, where the hysteresis dissipates nothing."""
        p = self.values
        stiffness = p.stiffness_n_m + p.hysteretic_stiffness_n_m
        return p.damping_n_s_m / (2 * math.sqrt(stiffness * p.mass_kg))

    @property
    def delay_samples(self) -> int:
        """Delay of a step in samples: the later samples from which a band-limited force is interpolated."""
        return half_width(self.between) - 1

    def at_sample_rate(self, fs_hz: float) -> "BoucWenOscillator":
        """Return the same oscillator at another sample rate, integrated in steps that are no longer."""
        steps = math.ceil(self.steps * self.sample_rate_hz / fs_hz)
        return BoucWenOscillator(
            fs_hz, self.values._asdict(), self.between, max(steps, 1), self.get_buffer("offset_um").item()
        )

    def simulate(self, force: Tensor, periodic: bool = False) -> Tensor:
        """Simulate displacements, (batch, time), µm, for forces, (batch, time), N.

        Args:
            force: Each row keeps its first value before the record and its last value after it.
            periodic: Whether the force is one period of a periodic force and the displacement that of the
                steady state; otherwise the oscillator starts at rest.

        Raises:
            StageError: A wrong shape, a value that is not finite, a solution that diverges or never settles.
        """
        if force.ndim != 2 or force.shape[1] == 0:
            raise StageError(f"force: found an array of shape {tuple(force.shape)}, expected (batch, time)")
        u = force.detach().to(torch.float64).contiguous().numpy()
        if not np.isfinite(u).all():
            raise StageError("force: found a value that is not finite, expected numbers")
        y = np.empty_like(u)
        bounded, steady = np.ones(len(u), dtype=bool), np.ones(len(u), dtype=bool)

        def run(first: int, last: int) -> None:
            for i in range(first, last):
                if periodic:
                    bounded[i], steady[i] = self._settle(u[i], y[i])
                else:
                    bounded[i] = self._from_rest(u[i], y[i])

        in_threads(run, len(u))
        if not bounded.all():
            raise StageError("force: found one with an unbounded displacement, expected a smaller one")
        if not steady.all():
            raise StageError(f"force: found no steady state within {MOST_PERIODS} periods, expected one")
        return torch.from_numpy(y)

    def _from_rest(self, u: np.ndarray, y: np.ndarray) -> bool:
        late = self.delay_samples
        given = np.concatenate([u, np.full(late, u[-1])])
        found = np.zeros_like(given)
        bounded = self.advance(given, self.initial_state(), found)
        y[:] = found[late:]
        return bounded

    def _settle(self, u: np.ndarray, y: np.ndarray) -> tuple[bool, bool]:
        """Fill `y` with the steady-state period; return whether it is bounded, and whether it was reached."""
        state = self.initial_state()
        found, last = np.zeros_like(u), np.full_like(u, np.inf)
        for _ in range(MOST_PERIODS):
            if not self.advance(u, state, found):
                return False, True
            if np.abs(found - last).max() <= PERIODIC * np.abs(found).max():
                y[:] = np.roll(found, -self.delay_samples)
                return True, True
            last[:] = found
        return True, False

    def initial_state(self) -> OscillatorState:
        """Return the state at rest, before the first sample."""
        return OscillatorState(np.zeros(2 * half_width(self.between)))

    def advance(self, u: np.ndarray, state: OscillatorState, y: np.ndarray) -> bool:
        """Fill `y`, `delay_samples` late, and advance the state; return False if the solution diverges.

        A record that is processed in windows gives bit-identical results.
        """
        bounded: bool = bouc_wen_oscillator(
            u,
            self._taps,
            np.array(self.values),
            1 / (self.sample_rate_hz * self.steps),
            state.past,
            state.before,
            state.motion,
            y,
        )
        state.past += len(u)
        y *= UM_PER_M
        y += self.get_buffer("offset_um").item()
        return bounded

    def stream(self) -> "OscillatorStream":
        """Return a stream that runs the oscillator one sample at a time."""
        return OscillatorStream(self)

    def plain(self) -> dict[str, Any]:
        return {
            "sample_rate_hz": self.sample_rate_hz,
            "parameters": self.values._asdict(),
            "between": self.between,
            "steps": self.steps,
            "offset_um": self.get_buffer("offset_um").item(),
        }


class OscillatorStream:
    """An oscillator that runs one sample at a time, bit-identical to a run over the whole record.

    Args:
        oscillator: The oscillator that is stepped.
    """

    def __init__(self, oscillator: BoucWenOscillator) -> None:
        self.delay_samples = oscillator.delay_samples
        self._oscillator = oscillator
        self._state = oscillator.initial_state()

    def reset(self) -> None:
        """Return to rest."""
        self._state = self._oscillator.initial_state()

    def step(self, u: float) -> float:
        """Return the displacement, µm, `delay_samples` samples before this force, N; until then that at rest.

        Raises:
            StageError: A force that is not finite, which leaves the state unchanged, or that is too large.
        """
        if not math.isfinite(u):
            raise StageError(f"u: found {u} N at sample {self._state.past}, expected a finite number")
        y = np.zeros(1)
        if not self._oscillator.advance(np.array([u]), self._state, y):
            raise StageError(f"u: found {u} N at sample {self._state.past - 1}, whose response is unbounded")
        return float(y[0])


def _check(name: str, value: float) -> None:
    """Check that a parameter's value has a physical meaning.

    Raises:
        StageError: It has none.
    """
    if not math.isfinite(value):
        raise StageError(f"{name}: found {value}, expected a finite number")
    if name in ("mass_kg", "hysteretic_stiffness_n_m", "stiffness_n_m", "exponent") and value <= 0:
        raise StageError(f"{name}: found {value:g}, expected a positive number")
    if name in ("damping_n_s_m", "dissipation") and value < 0:
        raise StageError(f"{name}: found {value:g}, expected a number that is not negative")
