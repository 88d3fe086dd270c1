"""The augmented stage: what a diagnosis named, around a hysteresis with its own weights.

    command → alignment → effects before → hysteresis → effects after → reading

The effects stand in the order of `EFFECTS`. The stage simulates, it is differentiable, and its file is plain
data.
"""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor, nn

from torchpi.errors import ArtifactError, StageError
from torchpi.files import write_atomically
from torchpi.operators.base import Operator
from torchpi.operators.noise import white_noise
from torchpi.operators.quantity import Quantity
from torchpi.stage.chain import ChainStream
from torchpi.stage.effects import EFFECTS
from torchpi.stage.effects.effect import Effect
from torchpi.stage.effects.held import hold_first_block
from torchpi.stage.effects.inside import InsideEffect
from torchpi.stage.effects.mechanics.modal import MODAL, ModalEffect
from torchpi.stage.effects.mechanics.modes import Modes, Part
from torchpi.stage.effects.unknown import Unknown
from torchpi.stage.hysteresis import Hysteresis
from torchpi.stage.stream import RigStream, StageStream

SCHEMA, VERSION = "torchpi augmented stage", 1


class AugmentedStage(Operator):
    """A stage as recordings show it, with what was found to be missing.

    `forward` maps volts to what a recording would hold, µm, without noise. Effects of the sensor are in it:
    recordings show nothing else. `simulate` and `stream` are the rig with noise that a control loop takes.

    Args:
        sample_period_s: T.
        hysteresis: Arguments of `Hysteresis`, which see, beside the period.
        effects: Each {`name`, `values`: its parameters, `aux`: name of the signal that it takes, if any};
            `modal`: true for those that act together, as `Modes`.
        alignment: Whether y(k) answers the command of tick k (0) or that of the tick before (1). It is a
            convention of who recorded: one sample stays one sample at any rate.
        noise_um: Rms of the noise of one reading.
        min_voltage_v: Lower end of the voltages that it stands for; None where none is known.
        max_voltage_v: Upper end.
        seed: Of the noise.
        stepped: Whether the displacement of the ceramic is held through each sample, as the command is: what
            the first dynamic block is to know.
        zero_um: What the sensor reads of the de-energised stage.

    Raises:
        StageError: An unknown effect, a value out of its bounds, or another alignment.
    """

    def __init__(
        self,
        sample_period_s: float,
        hysteresis: Mapping[str, Any],
        effects: Sequence[Mapping[str, Any]] = (),
        alignment: int = 0,
        noise_um: float = 0.0,
        min_voltage_v: float | None = None,
        max_voltage_v: float | None = None,
        seed: int = 0,
        stepped: bool = False,
        zero_um: float = 0.0,
    ) -> None:
        super().__init__()
        if alignment not in (0, 1):
            raise StageError(f"alignment: found {alignment}, want 0 or 1 samples")
        self.sample_period_s = PERIOD.check("sample_period_s", sample_period_s)
        self.alignment = int(alignment)
        self.noise_um = NOISE.check("noise_um", noise_um)
        self.min_voltage_v = -math.inf if min_voltage_v is None else float(min_voltage_v)
        self.max_voltage_v = math.inf if max_voltage_v is None else float(max_voltage_v)
        self.seed = int(seed)
        self.named = sorted((_named(entry) for entry in effects), key=lambda named: ORDER[named.name])
        shape: dict[str, float] = dict(hysteresis.get("shape") or {})
        self.effects = nn.ModuleList()
        for named in self.named:
            if issubclass(named.kind, InsideEffect):
                shape |= {
                    name: named.kind.quantities[name].check(name, v) for name, v in named.values.items()
                }
            elif issubclass(named.kind, Effect):
                self.effects.append(named.kind(self.sample_period_s, **named.values))
            elif named is self._modal()[-1]:
                self.effects.append(Modes(self.sample_period_s, [one.part() for one in self._modal()]))
        self.stepped, self.zero = bool(stepped), Zero(zero_um)
        hold_first_block(list(self.effects), self.stepped)  # type: ignore[arg-type]
        self.hysteresis = Hysteresis(self.sample_period_s, **{**hysteresis, "shape": shape})

    @classmethod
    def load(cls, path: str | Path) -> "AugmentedStage":
        """The stage in a file that `save` wrote.

        Raises:
            ArtifactError: No such file, or something else.
        """
        path = Path(path)
        if not path.is_file():
            raise ArtifactError(f"{path}: no such file, {WANTED}")
        try:
            with warnings.catch_warnings():
                # torch warns before it refuses a TorchScript file; ours is the error that follows.
                warnings.filterwarnings("ignore", message=".*TorchScript archive.*")
                settings = torch.load(path, map_location="cpu", weights_only=True)
        except Exception as error:  # bytes of anything make the unpickler raise anything
            raise ArtifactError(f"{path}: not a stage file, {WANTED}") from error
        if not isinstance(settings, dict) or settings.get("schema") != SCHEMA:
            raise ArtifactError(f"{path}: a file of something else, {WANTED}")
        if settings["version"] != VERSION:
            raise ArtifactError(
                f"{path}: found version {settings['version']}, want {VERSION}; diagnose the recordings again"
            )
        try:
            return cls.from_dict(settings)
        except (KeyError, TypeError, StageError) as error:
            raise ArtifactError(f"{path}: damaged, {WANTED}: {error}") from error

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> "AugmentedStage":
        """The stage of these settings, which are the constructor's arguments and stand in the file."""
        return cls(**{name: value for name, value in settings.items() if name not in ("schema", "version")})

    def save(self, path: str | Path) -> None:
        """Write the file: plain numbers and tensors, which `torch.load` reads with weights only."""
        with write_atomically(path) as temporary:
            torch.save({"schema": SCHEMA, "version": VERSION, **self.to_dict()}, temporary)

    def to_dict(self) -> dict[str, Any]:
        """Plain settings with the present values of the parameters: `from_dict` gives this stage again."""
        return {
            "sample_period_s": self.sample_period_s,
            "hysteresis": self.hysteresis.settings(),
            "effects": self._entries(),
            "alignment": self.alignment,
            "noise_um": self.noise_um,
            "min_voltage_v": self.min_voltage_v,
            "max_voltage_v": self.max_voltage_v,
            "seed": self.seed,
            "stepped": self.stepped,
            "zero_um": self.zero.zero_um,
        }

    def at_sample_rate(self, sample_rate_hz: float) -> "AugmentedStage":
        """The same physics at another rate. Parameters are copied."""
        return self.from_dict({**self.to_dict(), "sample_period_s": 1.0 / sample_rate_hz})

    def plain(self) -> "AugmentedStage":
        """Its hysteresis without any of the effects. Parameters are copied."""
        settings = self.to_dict()
        hysteresis = settings["hysteresis"]
        inside = {
            name for named in self.named if issubclass(named.kind, InsideEffect) for name in named.values
        }
        shape = {name: value for name, value in hysteresis["shape"].items() if name not in inside}
        return self.from_dict({**settings, "effects": [], "hysteresis": {**hysteresis, "shape": shape}})

    @property
    def sample_rate_hz(self) -> float:
        return 1.0 / self.sample_period_s

    @property
    def names(self) -> tuple[str, ...]:
        """The effects in it, in the order of the chain."""
        return tuple(named.name for named in self.named)

    @property
    def aux_names(self) -> tuple[str, ...]:
        """The auxiliary signals that it takes."""
        return tuple(dict.fromkeys(named.aux for named in self.named if named.aux))

    def initial_state(self, batch: int) -> Tensor:
        parts = [operator.initial_state(batch) for operator, _ in self._series()]
        return torch.cat([torch.zeros(batch, self.alignment, dtype=torch.float64), *parts], 1)

    def forward(
        self,
        x: Tensor,  # (batch, time), V
        state: Tensor | None = None,  # (batch, states)
        aux: Mapping[str, Tensor] | None = None,  # (batch, time) under each of `aux_names`
    ) -> tuple[Tensor, Tensor]:  # (batch, time), µm; (batch, states)
        for named in self.named:
            if named.aux and named.aux not in (aux or {}):
                raise StageError(f"{named.name}: found no signal '{named.aux}', want it beside the voltage")
        state = self.initial_state(len(x)) if state is None else state
        series = self._series()
        sizes = [self.alignment, *(operator.initial_state(1).shape[1] for operator, _ in series)]
        held, *parts = state.split(sizes, 1)
        x = torch.cat([held.to(x.dtype), x], 1)
        samples = x.shape[1] - self.alignment
        x, after = x[:, :samples], [x[:, samples:].to(state.dtype)]
        for (operator, name), part in zip(series, parts, strict=True):
            if isinstance(operator, Modes):
                x, part = operator(x, part, [aux[name] for name in operator.aux_names])  # type: ignore[index]
            else:
                x, part = operator(x, part, aux[name]) if name else operator(x, part)  # type: ignore[index]
            after.append(part)
        return x, torch.cat(after, 1)

    def simulate(
        self,
        u: Tensor,  # (batch, time), V
        seed: int | None = None,  # of the noise; the stage's own by default
    ) -> tuple[Tensor, Tensor]:  # (batch, time), µm, twice
        """The displacement, and what is read of it, from the de-energised state; other axes are at rest."""
        u = u.to(torch.float64)
        y, _ = self(u, None, {name: torch.zeros_like(u) for name in self.aux_names})
        return y, y + self.noise_um * white_noise(self.seed if seed is None else seed, *u.shape)

    def stream(self, compiled: bool = True) -> StageStream:  # type: ignore[override]
        """The rig sample by sample, with the parameters of now: `reset(seed)`, `step(u)` → (y, reading).

        The same numbers as row 0 of `simulate`, to the last bit.

        Args:
            compiled: Whether TorchScript compiles the step: about a second once, then the faster way.
        """
        late = [OneSampleLate()] if self.alignment else []
        chain = ChainStream([*late, *(operator.stream() for operator, _ in self._series())])
        nothing = [ChainStream([]) for _ in range(3)]
        rig = RigStream(nothing[0], chain, nothing[1], self.noise_um, nothing[2])
        return StageStream(rig, self.seed, compiled)

    def _series(self) -> list[tuple[Operator, str]]:
        """Every operator, first to last, with the signal that it alone takes, if any."""
        parts = self._modal()
        outside = [n for n in self.named if issubclass(n.kind, Effect) or (parts and n is parts[-1])]
        placed = [(cast(Effect, e), named.aux) for e, named in zip(self.effects, outside, strict=True)]
        before = [(effect, aux) for effect, aux in placed if effect.before_hysteresis]
        after = [(effect, aux) for effect, aux in placed if not effect.before_hysteresis]
        return [*before, (self.hysteresis, ""), *after, (self.zero, "")]

    def _modal(self) -> list["Named"]:
        """What acts together."""
        return [named for named in self.named if issubclass(named.kind, ModalEffect)]

    def _entries(self) -> list[dict[str, Any]]:
        """The effects as the constructor takes them, with their present parameters."""
        outside = iter(effect for effect in self.effects if not isinstance(effect, Modes))
        modes = next((effect for effect in self.effects if isinstance(effect, Modes)), None)
        shape, entries, part = self.hysteresis.shape(), [], 0
        for named in self.named:
            entry: dict[str, Any] = {"name": named.name, "values": {}, "aux": named.aux}
            if issubclass(named.kind, InsideEffect):
                entry["values"] = {name: shape[name] for name in named.values}
            elif issubclass(named.kind, Effect):
                entry["values"] = cast(Effect, next(outside)).values()
            elif modes is not None:
                entry |= {"values": modes.part_values(part), "modal": True}
                part += 1
            entries.append(entry)
        return entries


class Zero(Operator):
    """The zero of the sensor, behind everything that has memory: a constant has no transient."""

    def __init__(self, zero_um: float) -> None:
        super().__init__()
        self.zero_um = float(zero_um)

    def forward(self, x: Tensor, state: Tensor | None = None) -> tuple[Tensor, Tensor]:
        return x + self.zero_um, self.initial_state(len(x)) if state is None else state

    def stream(self) -> nn.Module:
        return ZeroStream(self.zero_um)


class ZeroStream(nn.Module):
    """The zero, one sample at a time."""

    def __init__(self, zero_um: float) -> None:
        super().__init__()
        self.zero_um = zero_um

    @torch.jit.export
    def reset(self) -> None:
        return

    @torch.jit.export
    def step(self, x: float) -> float:
        return x + self.zero_um


class OneSampleLate(nn.Module):
    """Alignment 1, one sample at a time."""

    def __init__(self) -> None:
        super().__init__()
        self.held = 0.0

    @torch.jit.export
    def reset(self) -> None:
        self.held = 0.0

    @torch.jit.export
    def step(self, x: float) -> float:
        before = self.held
        self.held = x
        return before


@dataclass(frozen=True)
class Named:
    """An effect of the stage, as it was given."""

    kind: type[Effect] | type[InsideEffect] | type[ModalEffect]
    values: dict[str, float]
    aux: str

    @property
    def name(self) -> str:
        return self.kind.name

    def part(self) -> Part:
        """It as one of those that act together."""
        return Part(cast(type[ModalEffect], self.kind), self.values, self.aux)


WANTED = "want a stage.pt of 'torchpi diagnose'"
PERIOD = Quantity("s", at_least=0, positive=True)
NOISE = Quantity("µm", at_least=0)
KNOWN = (*EFFECTS, Unknown)
ORDER = {effect.name: place for place, effect in enumerate(KNOWN)}


def _named(entry: Mapping[str, Any]) -> Named:
    name, aux = entry["name"], entry.get("aux") or ""
    if name not in ORDER:
        raise StageError(f"effects: found '{name}', want one of {', '.join(ORDER)}")
    kind = MODAL[name] if entry.get("modal") else KNOWN[ORDER[name]]
    if kind.takes_aux != bool(aux):
        wanted = "the name of the signal that it takes" if kind.takes_aux else "none"
        raise StageError(f"{name}: found the auxiliary signal '{aux}', want {wanted}")
    return Named(kind, dict(entry["values"]), aux)
