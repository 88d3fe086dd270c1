"""A stage of several axes: m voltages in, p displacements out.

    voltages → amplifier and plays of each actuator → shared modes ⇄ nonlinear elements → displacements

`torchpi.operators.modal_feedback` gives the equations. Their numbers are the stage's parameters, float64.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from torchpi.errors import StageError
from torchpi.operators.compiled import in_threads
from torchpi.operators.modal_feedback import (
    Constants,
    Parameters,
    Shapes,
    foreseen,
    modal_feedback,
    parameter_shapes,
)
from torchpi.operators.oversampled_inputs import LOOKAHEAD, OversampledInputs
from torchpi.stage.file import SavedStage

RATE_TOLERANCE = 1e-3
"""Largest accepted relative deviation of a sample rate from the stage's."""

SETTINGS = (
    "sample_rate_hz",
    "input_thresholds_v",
    "input_rates_hz",
    "dead_zones",
    "thresholds",
    "rates_hz",
    "times_s",
    "crossover_v_per_s",
    "amplifier_hz",
)


@dataclass
class MultiAxisState:
    """State of a batch after a sample: modes, plays, means, and the number of samples processed."""

    x: np.ndarray  # (batch, modes, 2), the unit of `drive` times V
    h: np.ndarray  # (batch, elements, plays), the unit of `sensed` times x
    means: np.ndarray  # (batch, elements, means), likewise in units of what the elements sense
    past: int = 0


class MultiAxisStage(SavedStage):
    """Modes that several inputs share, with hysteresis at each actuator and in the feedback.

    Args:
        sample_rate_hz: Sample rate of voltages and displacements; the modes are discrete at this rate.
        parameters: Arrays by name: `poles`, `drive`, `force`, `sensed`, `through`, `weights`, `play_weights`,
            `seen`, `direct`, `ahead`, with the shapes of `parameter_shapes`.
        input_thresholds_v: Thresholds of the relaxing plays of each input, V.
        input_rates_hz: Relaxation rates of these plays at small motions.
        dead_zones: Thresholds of the elements' dead zones, in units of what the elements sense.
        thresholds: Thresholds of the elements' relaxing plays, in the same units.
        rates_hz: Relaxation rates of these plays at small motions.
        times_s: Averaging times of the elements' means.
        crossover_v_per_s: Widths of the crossover distortion of each amplifier, V/s.
        amplifier_hz: The amplifiers' bandwidth, Hz.
        offset_um: Readings of the sensors at rest, (outputs,); zeros by default.

    Raises:
        StageError: A parameter that is missing, of the wrong shape, or not finite, or poles outside the unit
            circle.
    """

    SCHEMA, VERSION, KIND = "torchpi multi-axis stage", 5, "a stage of several axes"

    def __init__(
        self,
        sample_rate_hz: float,
        parameters: Mapping[str, Any],
        input_thresholds_v: Sequence[float] = (),
        input_rates_hz: Sequence[float] = (),
        dead_zones: Sequence[float] = (),
        thresholds: Sequence[float] = (),
        rates_hz: Sequence[float] = (),
        times_s: Sequence[float] = (),
        crossover_v_per_s: Sequence[float] = (),
        amplifier_hz: float = math.inf,
        offset_um: Sequence[float] | None = None,
    ) -> None:
        super().__init__()
        if not (math.isfinite(sample_rate_hz) and sample_rate_hz > 0):
            raise StageError(f"sample_rate_hz: found {sample_rate_hz}, expected a positive number")
        self.sample_rate_hz = float(sample_rate_hz)
        self.input_thresholds_v = _numbers("input_thresholds_v", input_thresholds_v, positive=True)
        self.input_rates_hz = _numbers("input_rates_hz", input_rates_hz, positive=True)
        self.crossover_v_per_s = _numbers("crossover_v_per_s", crossover_v_per_s, positive=True)
        if not amplifier_hz > 0 or (self.crossover_v_per_s and not math.isfinite(amplifier_hz)):
            raise StageError(f"amplifier_hz: found {amplifier_hz}, expected a positive number")
        self.amplifier_hz = float(amplifier_hz)
        self.dead_zones = _numbers("dead_zones", dead_zones)
        self.thresholds = _numbers("thresholds", thresholds, positive=True)
        self.rates_hz = _numbers("rates_hz", rates_hz, positive=True)
        for name, few, many in (
            ("input_rates_hz", self.input_rates_hz, self.input_thresholds_v),
            ("rates_hz", self.rates_hz, self.thresholds),
        ):
            if len(few) != len(many):
                raise StageError(f"{name}: found {len(few)}, expected one for each of {len(many)} thresholds")
        self.times_s = _numbers("times_s", times_s, positive=True)
        arrays = {name: np.asarray(value, dtype=np.float64) for name, value in parameters.items()}
        self.shapes = self._shapes(arrays)
        for name, shape in parameter_shapes(self.shapes).items():
            value = arrays[name]
            if value.shape != shape:
                raise StageError(f"{name}: found an array of shape {value.shape}, expected {shape}")
            if not np.isfinite(value).all():
                raise StageError(f"{name}: found a value that is not finite, expected numbers")
            setattr(self, name, nn.Parameter(torch.from_numpy(value.copy())))
        if (np.square(arrays["poles"]).sum(1) >= 1).any():
            raise StageError("poles: found one outside the unit circle, expected stable modes")
        offset = np.zeros(self.outputs) if offset_um is None else np.asarray(offset_um, dtype=np.float64)
        if offset.shape != (self.outputs,) or not np.isfinite(offset).all():
            raise StageError(f"offset_um: found {offset.tolist()}, expected {self.outputs} finite numbers")
        self.register_buffer("offset_um", torch.from_numpy(offset.copy()))

    def _shapes(self, arrays: Mapping[str, np.ndarray]) -> Shapes:
        names = list(parameter_shapes(Shapes(0, 0, 0, 0, 0, 0)))
        if set(arrays) != set(names):
            raise StageError(f"parameters: found {sorted(arrays)}, expected {', '.join(names)}")
        for name, expected in (("direct", 2), ("weights", 2), ("ahead", 3)):
            if arrays[name].ndim != expected:
                raise StageError(f"{name}: found {arrays[name].ndim} dimensions, expected {expected}")
        ahead = arrays["ahead"].shape[2]
        if ahead > LOOKAHEAD:
            raise StageError(f"ahead: found {ahead} samples, expected at most {LOOKAHEAD}")
        outputs, inputs = arrays["direct"].shape
        excess = len(self.input_thresholds_v) + 2 * len(self.crossover_v_per_s)
        functions = len(self.dead_zones) + len(self.thresholds) + len(self.times_s) + 1
        return Shapes(inputs, outputs, len(arrays["poles"]), len(arrays["weights"]), functions, excess, ahead)

    @property
    def inputs(self) -> int:
        return self.shapes.inputs

    @property
    def outputs(self) -> int:
        return self.shapes.outputs

    def mismatch(self, inputs: int, outputs: int, fs_hz: float) -> str | None:
        """Describe how these axes or this sample rate differ from the stage's; None if they agree."""
        own = (self.inputs, self.outputs)
        if (inputs, outputs) != own:
            return f"found {inputs} inputs and {outputs} outputs, expected {own[0]} and {own[1]} as in"
        if abs(fs_hz - self.sample_rate_hz) > RATE_TOLERANCE * self.sample_rate_hz:
            return f"found {fs_hz:g} Hz, expected {self.sample_rate_hz:g} Hz as in"
        return None

    def offset(self) -> np.ndarray:
        """Return the readings of the sensors at rest, (outputs,), µm."""
        return np.asarray(self.get_buffer("offset_um"))

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the parameters by name, in the order of a fit."""
        named = dict(self.named_parameters())
        return {name: named[name].detach().contiguous().numpy() for name in parameter_shapes(self.shapes)}

    def kernel_parameters(self) -> Parameters:
        """Return the parameters as the kernel takes them."""
        arrays = self.arrays()
        return Parameters(*(arrays[name] for name in Parameters._fields))

    def thresholds_of_kernel(self) -> Constants:
        """Return dead zones, thresholds, decay per sample at small motions, and share in each mean."""
        kept = np.exp(-2 * np.pi * np.asarray(self.rates_hz, dtype=np.float64) / self.sample_rate_hz)
        shares = 1 / (np.asarray(self.times_s, dtype=np.float64) * self.sample_rate_hz)
        return Constants(
            np.asarray(self.dead_zones), np.asarray(self.thresholds), kept, np.minimum(shares, 1.0)
        )

    @property
    def delay_samples(self) -> int:
        """Delay of a step in samples: the look-ahead that the plays of the inputs need."""
        return LOOKAHEAD

    def excess(self, u: np.ndarray) -> np.ndarray:
        """Return what plays and amplifiers add to voltages (time, inputs), V, as (time, inputs, terms)."""
        return self._inputs().advance(_padded(u))[LOOKAHEAD:]

    def driven(self, u: np.ndarray) -> np.ndarray:
        """Add to voltages (time, inputs), V, all terms of plays and amplifiers: v of `modal_feedback`."""
        added = self.input_stream().advance(_padded(u))[LOOKAHEAD:]
        return np.asarray(u + added[:, :, 0])

    def foreseen(self, u: np.ndarray) -> np.ndarray:
        """Return what future voltages contribute to the displacements, (time, outputs), µm.

        Args:
            u: (time, inputs), V, with `shapes.ahead` more samples at the end than displacements.
        """
        return foreseen(u, self.arrays()["ahead"])

    def input_stream(self) -> OversampledInputs:
        """Return a stream of what `driven` adds, window by window, `LOOKAHEAD` samples late."""
        return self._inputs(self.arrays()["play_weights"].copy())

    def _inputs(self, weights: np.ndarray | None = None) -> OversampledInputs:
        return OversampledInputs(
            self.inputs,
            self.sample_rate_hz,
            self.input_thresholds_v,
            self.input_rates_hz,
            self.crossover_v_per_s,
            self.amplifier_hz,
            weights,
        )

    def initial_state(self, batch: int) -> MultiAxisState:
        """Return the state at rest."""
        n = self.shapes.elements
        return MultiAxisState(
            np.zeros((batch, self.shapes.modes, 2)),
            np.zeros((batch, n, len(self.thresholds))),
            np.zeros((batch, n, len(self.times_s))),
        )

    def simulate(self, u: Tensor) -> Tensor:
        """Return displacements, (batch, time, outputs), µm, from rest for voltages (batch, time, inputs), V.

        Raises:
            StageError: A wrong number of inputs, a value that is not finite, or states that diverge.
        """
        if u.ndim != 3 or u.shape[2] != self.inputs:
            raise StageError(
                f"voltages: found an array of shape {tuple(u.shape)}, expected (batch, time, {self.inputs})"
            )
        volts = u.detach().to(torch.float64).contiguous().numpy()
        if not np.isfinite(volts).all():
            raise StageError("voltages: found a value that is not finite, expected numbers")
        driven = np.empty_like(volts)

        def run(first: int, last: int) -> None:
            for i in range(first, last):
                driven[i] = self.driven(volts[i])

        in_threads(run, len(volts))
        state, y = self.initial_state(len(volts)), np.zeros((*volts.shape[:2], self.outputs))
        self.advance(driven, state, y)
        for given, found in zip(volts, y, strict=True):
            found += self.foreseen(_padded(given, self.shapes.ahead))
        return torch.from_numpy(y)

    def advance(self, driven: np.ndarray, state: MultiAxisState, y: np.ndarray) -> None:
        """Fill `y`, except for what `foreseen` adds, and advance the state to after the last sample.

        A record that is processed in windows gives bit-identical results.

        Args:
            driven: (batch, time, inputs), V, from `driven`.
            state: State of this batch, updated.
            y: (batch, time, outputs), µm, written.

        Raises:
            StageError: The states diverge.
        """
        in_driven = np.zeros((self.inputs, 0))
        parameters, constants = self.kernel_parameters(), self.thresholds_of_kernel()
        parameters = parameters._replace(play_weights=in_driven)
        nothing = np.zeros((driven.shape[1], self.inputs, 0))
        bounded = np.zeros(len(driven), dtype=bool)

        def run(first: int, last: int) -> None:
            for i in range(first, last):
                bounded[i] = modal_feedback(
                    driven[i], nothing, parameters, constants, state.x[i], state.h[i], state.means[i],
                    state.past, y[i], np.zeros((0, 0)),
                )  # fmt: skip

        in_threads(run, len(driven))
        if not bounded.all():
            raise StageError("voltages: found some with an unbounded response, expected smaller ones")
        state.past += driven.shape[1]
        y += self.offset()

    def plain(self) -> dict[str, Any]:
        settings = {name: getattr(self, name) for name in SETTINGS}
        parameters = {name: torch.from_numpy(value.copy()) for name, value in self.arrays().items()}
        return {**settings, "offset_um": self.get_buffer("offset_um").tolist(), "parameters": parameters}


def _numbers(name: str, values: Sequence[float], positive: bool = False) -> list[float]:
    numbers = [float(value) for value in values]
    if not all(math.isfinite(value) and (value > 0 or not positive) for value in numbers):
        raise StageError(f"{name}: found {numbers}, expected finite{' positive' * positive} numbers")
    return numbers


def _padded(u: np.ndarray, samples: int = LOOKAHEAD) -> np.ndarray:
    """Append to voltages the samples that the look-ahead needs, all 0."""
    return np.pad(u, ((0, samples), (0, 0)))
