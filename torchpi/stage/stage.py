"""A stage: a hysteresis inside a chain of effects, from a file, from settings, or from a diagnosis.

    command → D/A → limits → alignment → effects before → hysteresis → effects after → displacement
            → sensor → noise → A/D → reading

The effects act in the order of `EFFECTS`. A stage simulates, is differentiable in its physical parameters,
and is saved as plain data.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self, cast, overload

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from torchpi.errors import ArtifactError, ConfigError, StageError, is_whole, kind_of
from torchpi.files import config_file, write_atomically
from torchpi.operators.base import Operator, StepStream
from torchpi.operators.chain import Chain, ChainStream
from torchpi.operators.limits import clip_step
from torchpi.operators.noise import white_noise
from torchpi.operators.quantity import Quantity, check_order
from torchpi.operators.quantization import Converter
from torchpi.recordings.options import SIMULATED_COLUMN
from torchpi.simulators import COLUMN, Simulator
from torchpi.stage.alignment import OneSampleEarly, OneSampleLate, Zero
from torchpi.stage.effect_settings import EffectSettings, in_order
from torchpi.stage.effects.amplifier.delay import Delay
from torchpi.stage.effects.amplifier.slew_limit import SlewLimit
from torchpi.stage.effects.effect import Effect, Parameters
from torchpi.stage.effects.held import hold_first_block
from torchpi.stage.effects.inside import InsideEffect
from torchpi.stage.effects.mechanics.modal import ModalEffect
from torchpi.stage.effects.mechanics.modes import Modes, Part
from torchpi.stage.file import EXPECTED, read_settings, write_settings
from torchpi.stage.hysteresis import Hysteresis
from torchpi.stage.identified import Identified
from torchpi.stage.settings import NOISE, build, of_sections, read_yaml
from torchpi.stage.simulated import SimulatedHysteresis
from torchpi.stage.stream import RigStream, StageStream

RATE = Quantity("Hz", at_least=0, at_most=1e8, positive=True)  # a thousand times the fastest controller
Array = npt.NDArray[np.float64]
SEED = Quantity("", at_least=0, at_most=2**63 - 1)


class Stage(Operator):
    """A stage, differentiable in its physical parameters.

    `forward` maps volts to the displacement in µm, without noise or converters; training differentiates
    through it. `stage.sensor(y)` is the sensor's response to that displacement. `simulate` and `stream` model
    the whole rig. The physical parameters are `parameters()`, float64, each in the unit given in its name.
    They stay on the CPU wherever the stage is moved; the displacement is on the device of the voltage.

    Args:
        sample_rate_hz: Sample rate of commands and readings.
        hysteresis: Arguments of `Hysteresis`, without the sample period.
        effects: One mapping per effect: {`name`, `values`: its parameters, `aux`: name of the signal that it
            takes, if any}; `modal`: true for effects that act together as `Modes`.
        sensor: Sensor effects that change the reading but not the displacement. A recording contains only
            the reading, so a stage that was identified has all its effects in `effects`.
        alignment: Whether y(k) responds to the command of tick k (0) or of the tick before (1). It is the
            recording's timing convention: one sample at any sample rate. A controller that reads, then
            writes, has 1. For a simulation that is called, -1 means that it responds one sample late.
        min_voltage_v: Lower end of the voltage range that the stage represents; None if unknown.
        max_voltage_v: Upper end of that range.
        saturates: Whether the amplifier clips the voltage at these ends.
        command_converter: Arguments of the D/A `Converter`; None is ideal.
        reading_converter: Arguments of the A/D `Converter`; None is ideal.
        noise_um: Rms of the noise of one reading.
        seed: Seed of the noise.
        stepped: Whether the displacement of the ceramic is held during each sample, as the command is.
        zero_um: Reading of the sensor when the stage is de-energised.
        identified: Fields of `Identified`: the recordings that the stage was identified from, and how well it
            predicts others; None for a stage that was specified by hand.

    Raises:
        StageError: An unknown effect, a value out of its bounds, or an unsupported alignment.

    Example:
        >>> import numpy as np
        >>> from torchpi import Stage
        >>> stage = Stage.from_yaml("default")
        >>> t = np.arange(4000) / stage.sample_rate_hz
        >>> displacement, reading = stage.simulate(5 - 5 * np.cos(2 * np.pi * 5 * t)[None])
        >>> f"{displacement.max():.2f} µm"  # at 10 V
        '8.08 µm'
    """

    def __init__(
        self,
        sample_rate_hz: float,
        hysteresis: Mapping[str, Any],
        effects: Sequence[Mapping[str, Any]] = (),
        sensor: Sequence[Mapping[str, Any]] = (),
        alignment: int = 0,
        min_voltage_v: float | None = None,
        max_voltage_v: float | None = None,
        saturates: bool = False,
        command_converter: Mapping[str, Any] | None = None,
        reading_converter: Mapping[str, Any] | None = None,
        noise_um: float = 0.0,
        seed: int = 0,
        stepped: bool = False,
        zero_um: float = 0.0,
        identified: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__()
        if alignment not in (0, 1) and not (alignment == -1 and hysteresis.get("simulation")):
            raise StageError(f"alignment: found {alignment}, expected 0 or 1 samples")
        self.sample_rate_hz = RATE.check("sample_rate_hz", sample_rate_hz)
        self.sample_period_s = 1.0 / self.sample_rate_hz
        self.alignment = int(alignment)
        self.min_voltage_v = -math.inf if min_voltage_v is None else float(min_voltage_v)
        self.max_voltage_v = math.inf if max_voltage_v is None else float(max_voltage_v)
        check_order("min_voltage_v", self.min_voltage_v, "max_voltage_v", self.max_voltage_v, "V")
        self.saturates = bool(saturates)
        self.noise_um = NOISE.check("noise_um", noise_um)
        self.seed = int(SEED.check("seed", seed))
        self.stepped, self.zero_um = bool(stepped), float(zero_um)
        self.identified = None if identified is None else Identified.from_plain(identified)
        self._named = in_order(effects)
        self._of_sensor = in_order(sensor)
        for one in self._of_sensor:
            if one.kind.block != "sensor" or not issubclass(one.kind, Effect) or one.aux:
                raise StageError(f"sensor: found '{one.kind.name}', expected effects of the sensor")
        outside, self._signals = self._operators()
        hold_first_block(outside, self.stepped)
        late: list[Operator] = (
            [OneSampleEarly()] if self.alignment < 0 else [OneSampleLate()] * self.alignment
        )
        before: list[Operator] = [*late, *(e for e in outside if e.before_hysteresis)]
        after: list[Operator] = [e for e in outside if not e.before_hysteresis]
        shape = dict(hysteresis.get("shape") or {}) | self._shape_inside()
        hysteresis = {**hysteresis, "shape": shape}
        simulated = bool(hysteresis.get("simulation"))
        self.hysteresis = (SimulatedHysteresis if simulated else Hysteresis)(
            self.sample_period_s, **hysteresis
        )
        if simulated:
            # Alignment and delays act behind a simulation, of which only the output may be known.
            before = [e for e in outside if e.before_hysteresis and not e.commutes]
            after = [*late, *(e for e in outside if e not in before)]
        if self.simulation == COLUMN:
            self._signals[self.hysteresis] = SIMULATED_COLUMN
        self.before, self.after = nn.ModuleList(before), nn.ModuleList([*after, Zero(self.zero_um)])
        self.sensor = Chain(
            **{f"{one.kind.name}_{k}": self._operator(one) for k, one in enumerate(self._of_sensor)}
        )
        self.command_converter = None if command_converter is None else Converter(**command_converter)
        self.reading_converter = None if reading_converter is None else Converter(**reading_converter)

    @classmethod
    def from_yaml(cls, path: str | Path) -> "Stage":
        """Return the stage in a YAML file, or one that torchpi includes, by its name: `default`, `qin2013`.

        Raises:
            ConfigError, StageError: The file does not exist, or has an invalid setting.
        """
        return cls.from_dict(read_yaml(config_file(path, "stage")), str(path))

    @classmethod
    def from_dict(
        cls,
        settings: Mapping[str, Any],
        source: str = "stage",  # its name in error messages
    ) -> "Stage":
        """Return the stage with these settings: sections as in its file, or the arguments of `Stage`.

        Raises:
            ConfigError: An unknown setting (the message names the nearest one), or a value of the wrong kind.
            StageError: An unphysical value.
        """
        try:
            whole = isinstance(settings, Mapping) and "hysteresis" in settings
            return build(cls, settings if whole else build(of_sections, settings))
        except (ConfigError, StageError) as error:
            raise type(error)(f"{source}: {error}") from error
        except (AttributeError, TypeError, ValueError) as error:  # inside effects, hysteresis, converters
            raise ConfigError(f"{source}: {error}") from error

    @classmethod
    def load(cls, path: str | Path) -> "Stage":
        """Return the stage in a file written by `save`, in a YAML file, or included in torchpi, by its name.

        Raises:
            ArtifactError: The file does not exist, or is not a stage file.
            ConfigError: Neither a file nor a known name, or an error in a YAML file.
        """
        path = config_file(path, "stage")
        if path.suffix in (".yaml", ".yml"):
            return cls.from_yaml(path)
        settings = read_settings(path)
        try:
            return cls.from_dict(settings)
        except (ConfigError, StageError) as error:
            raise ArtifactError(f"{path}: damaged, {EXPECTED}: {error}") from error

    def save(self, path: str | Path) -> None:
        """Write the file: plain numbers and their hash, which `torch.load` reads with weights only."""
        with write_atomically(path) as temporary:
            self.write(temporary)

    def write(self, path: Path) -> None:
        """Write the same file in place, for a caller that makes several files appear together."""
        write_settings(path, self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """Return plain settings with the present parameters, from which `from_dict` rebuilds this stage."""
        converters = [
            None if one is None else one.settings()
            for one in (self.command_converter, self.reading_converter)
        ]
        return {
            "sample_rate_hz": self.sample_rate_hz,
            "hysteresis": self.hysteresis.settings(),
            "effects": [one.plain() for one in self.effects],
            "sensor": [one.plain() for one in self.sensor_effects],
            "alignment": self.alignment,
            "min_voltage_v": self.min_voltage_v if math.isfinite(self.min_voltage_v) else None,
            "max_voltage_v": self.max_voltage_v if math.isfinite(self.max_voltage_v) else None,
            "saturates": self.saturates,
            "command_converter": converters[0],
            "reading_converter": converters[1],
            "noise_um": self.noise_um,
            "seed": self.seed,
            "stepped": self.stepped,
            "zero_um": self.zero_um,
            "identified": None if self.identified is None else self.identified.plain(),
        }

    def at_sample_rate(self, sample_rate_hz: float) -> "Stage":
        """Return a stage with the same physics at another sample rate. Parameters are copied."""
        found = self.from_dict({**self.to_dict(), "sample_rate_hz": sample_rate_hz})
        if isinstance(self.hysteresis, SimulatedHysteresis) and self.hysteresis.simulator:
            found = found.with_simulation(self.hysteresis.simulator)
        return found

    def plain(self) -> "Stage":
        """Return a stage with the same hysteresis and without effects. Parameters are copied."""
        settings = self.to_dict()
        hysteresis, inside = settings["hysteresis"], self._shape_inside()
        shape = {name: value for name, value in hysteresis["shape"].items() if name not in inside}
        bare = {"effects": [], "sensor": [], "hysteresis": {**hysteresis, "shape": shape}}
        return self.from_dict({**settings, **bare, "identified": None})

    @property
    def effects(self) -> tuple[EffectSettings, ...]:
        """The effects in the displacement, in the order of the chain, with their present parameters."""
        shape, operators = self.hysteresis.shape(), [*self.before, *self.after]
        modes = next((one for one in operators if isinstance(one, Modes)), None)
        alone = iter(one for one in operators if isinstance(one, Effect) and one is not modes)
        found, part = [], 0
        for one in self._named:
            if issubclass(one.kind, InsideEffect):
                values = {name: shape[name] for name in one.values}
            elif modes is not None and issubclass(one.kind, ModalEffect):
                values, part = modes.part_values(part), part + 1
            else:
                values = one.present(next(alone))
            found.append(one._replace(values=values))
        return tuple(found)

    @property
    def sensor_effects(self) -> tuple[EffectSettings, ...]:
        """The effects between the displacement and the reading, with their present parameters."""
        operators = cast(list[Effect], self.sensor.series())
        return tuple(
            one._replace(values=one.present(operator))
            for one, operator in zip(self._of_sensor, operators, strict=True)
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects in the displacement, in the order of the chain."""
        return tuple(one.kind.name for one in self._named)

    @property
    def aux_names(self) -> tuple[str, ...]:
        """Names of the auxiliary signals that the stage takes, including a simulation's recorded output."""
        simulated = [SIMULATED_COLUMN] if self.simulation == COLUMN else []
        return tuple(dict.fromkeys([*(one.aux for one in self._named if one.aux), *simulated]))

    @property
    def simulation(self) -> str:
        """Name of the external simulation that the stage corrects; empty if there is none."""
        return self.hysteresis.reference if isinstance(self.hysteresis, SimulatedHysteresis) else ""

    def with_simulation(self, simulator: Simulator | None) -> "Stage":
        """Return the same stage calling this simulator; a file only names its simulation, and never loads it.

        Raises:
            StageError: The stage calls no simulation.
        """
        found = self.from_dict(self.to_dict())
        if not isinstance(found.hysteresis, SimulatedHysteresis) or self.simulation == COLUMN:
            raise StageError(f"simulation: found {simulator}, expected none: this stage calls no simulation")
        found.hysteresis.simulator = simulator
        return found

    @property
    def max_slew_v_s(self) -> float:
        """The lowest slew limit of the amplifier, V/s; infinite without one."""
        rates = (one.values.get("rate_v_per_s", math.inf) for one in self.effects if one.kind is SlewLimit)
        return min(rates, default=math.inf)

    def series(self) -> list[Operator]:
        """Return every operator from the limited command to the displacement, first to last."""
        return [*self.before, self.hysteresis, *self.after]

    def initial_state(self, batch: int) -> Tensor:
        return torch.cat([operator.initial_state(batch).cpu() for operator in self.series()], 1)

    def forward(
        self,
        x: Tensor,  # (batch, time), V
        state: Tensor | None = None,  # (batch, states)
        aux: Mapping[str, Tensor] | None = None,  # (batch, time) under each of `aux_names`
    ) -> tuple[Tensor, Tensor]:  # (batch, time), µm; (batch, states)
        aux = aux or {}
        for name in self.aux_names:
            if name not in aux:
                takes = next((one.kind.name for one in self._named if one.aux == name), "simulation")
                raise StageError(f"{takes}: found no signal '{name}', expected it beside the voltage")
        outside = x
        x, state = x.cpu(), self.initial_state(len(x)) if state is None else state.cpu()
        series = self.series()
        sizes = [operator.initial_state(1).shape[1] for operator in series]
        if self.saturates:
            x = x.clamp(self.min_voltage_v, self.max_voltage_v)
        after = []
        for operator, part in zip(series, state.split(sizes, 1), strict=True):
            names = self._signals.get(operator, "")
            if isinstance(names, tuple):
                x, part = operator(x, part, [aux[name].cpu() for name in names])
            else:
                x, part = operator(x, part, aux[names].cpu()) if names else operator(x, part)
            after.append(part)
        return x.to(outside.device), torch.cat(after, 1).to(outside.device)

    def _apply(self, fn: Any, recurse: bool = True) -> Self:
        # A stage's kernels are compiled for the CPU, so its parameters stay there if a parent module moves.
        super()._apply(lambda tensor: fn(tensor).cpu(), recurse)
        return self

    @overload
    def simulate(self, u: Tensor, seed: int | None = None) -> tuple[Tensor, Tensor]: ...
    @overload
    def simulate(self, u: Array, seed: int | None = None) -> tuple[Array, Array]: ...
    def simulate(
        self,
        u: Tensor | Array,  # (batch, time), V
        seed: int | None = None,  # of the noise; the stage's own by default
    ) -> tuple[Tensor, Tensor] | tuple[Array, Array]:  # (batch, time), µm, twice
        """Simulate displacement and reading from the de-energised state, with the other axes at rest.

        Converters and noise are included. Each row has its own noise, the same in every call. A NumPy array
        gives NumPy arrays; a tensor gives tensors, which carry gradients.

        Raises:
            StageError: A shape other than (batch, time), a command that is not finite, or a delay that is
                longer than the record.
        """
        if isinstance(u, np.ndarray):
            with torch.no_grad():
                y, reading = self.simulate(_as_tensor(u), seed)
            return y.numpy(), reading.numpy()
        self._check_command(u)
        if seed is not None and not (is_whole(seed) and seed >= 0):
            raise StageError(f"seed: found {seed!r}, expected a whole number that is not negative")
        if self.simulation == COLUMN:
            raise StageError("simulation: found only a voltage, expected the simulator's output as well")
        command = u.to(torch.float64)
        if self.command_converter is not None:
            command, _ = self.command_converter(command)
        y, _ = self(command, None, {name: torch.zeros_like(command) for name in self.aux_names})
        reading, _ = self.sensor(y)
        reading = reading + self.noise_um * white_noise(self.seed if seed is None else seed, *u.shape)
        if self.reading_converter is not None:
            reading, _ = self.reading_converter(reading)
        return y, reading

    def stream(self, compiled: bool = True) -> StageStream:  # type: ignore[override]
        """Return the rig one sample at a time, as it is now: `reset(seed)`, `step(u)` → (y, reading).

        The stream equals row 0 of `simulate` to the last bit.

        Args:
            compiled: Whether TorchScript compiles the step, which takes about a second and makes it faster.
        """
        ends = [self.min_voltage_v, self.max_voltage_v, 0.0]
        limits = [StepStream(clip_step, ends)] if self.saturates else []
        command, reading = (
            [] if one is None else [one.stream()] for one in (self.command_converter, self.reading_converter)
        )
        chain = ChainStream([*command, *limits, *(operator.stream() for operator in self.series())])
        rig = RigStream(chain, self.sensor.stream(), self.noise_um, ChainStream(reading))
        return StageStream(rig, self.seed, compiled)

    def _check_command(self, u: Tensor) -> None:
        if not isinstance(u, Tensor):
            raise StageError(f"u: found {kind_of(u)}, expected a tensor or a NumPy array (batch, time)")
        if u.ndim != 2:
            raise StageError(f"u: found shape {tuple(u.shape)}, expected (batch, time)")
        if not u.numel():
            raise StageError(f"u: found shape {tuple(u.shape)}, expected at least one sample")
        finite = torch.isfinite(u)
        if not bool(finite.all()):
            row, sample = torch.nonzero(~finite)[0].tolist()
            found = f"{u[row, sample].item()} V in row {row}, sample {sample}"
            raise StageError(f"u: found {found}, expected finite numbers")
        delay_s = sum(one.delay_s.item() for one in self.before if isinstance(one, Delay))
        duration_s = u.shape[1] * self.sample_period_s
        if delay_s >= duration_s:
            raise StageError(f"delay_s: found {delay_s:g} s, expected less than the record, {duration_s:g} s")

    def _shape_inside(self) -> Parameters:
        """Return the shape parameters that the effects inside the hysteresis set."""
        inside = [one for one in self._named if issubclass(one.kind, InsideEffect)]
        return {name: value for one in inside for name, value in one.kind.checked(one.values).items()}

    def _operator(self, one: EffectSettings) -> Effect:
        return cast(type[Effect], one.kind)(self.sample_period_s, **one.values)

    def _operators(self) -> tuple[list[Effect], dict[nn.Module, str | tuple[str, ...]]]:
        """Return the effects outside the hysteresis, and the signals that each of them takes, if any."""
        operators: list[Effect] = []
        signals: dict[nn.Module, str | tuple[str, ...]] = {}
        modal = [one for one in self._named if issubclass(one.kind, ModalEffect)]
        for one in self._named:
            if issubclass(one.kind, Effect):
                operators.append(self._operator(one))
                signals[operators[-1]] = one.aux
            elif modal and one is modal[-1]:
                parts = [Part(cast(type[ModalEffect], m.kind), m.values, m.aux) for m in modal]
                operators.append(modes := Modes(self.sample_period_s, parts))
                signals[modes] = modes.aux_names
        return operators, signals


def _as_tensor(u: Array) -> Tensor:
    if u.dtype.kind not in "fiu":
        raise StageError(f"u: found an array of {u.dtype}, expected numbers")
    return torch.from_numpy(np.array(u, dtype=np.float64))
