"""The simulated stage: amplifier → actuator → mechanics → sensor.

At tick k the controller reads y(k), then writes u(k), which is held until tick k+1. So y(k) depends on
u up to k-1, and y(0) = 0 from the de-energised state.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchpi.errors import ConfigError, StageError
from torchpi.operators.noise import white_noise
from torchpi.operators.quantity import Quantity
from torchpi.stage.actuator import Actuator
from torchpi.stage.amplifier import Amplifier
from torchpi.stage.chain import Chain
from torchpi.stage.mechanics import Mechanics
from torchpi.stage.sensor import Sensor
from torchpi.stage.settings import build, read_yaml
from torchpi.stage.stream import RigStream, StageStream


class Stage(Chain):
    """A simulated stage, differentiable in its physical parameters.

    `forward` maps volts to the displacement itself, µm, without noise or converters: what training goes
    through. `stage.sensor(y)` adds the lag of the sensor. `simulate` and `stream` are the whole rig.
    Physical parameters are `parameters()`, float64, each in the unit of its name;
    `requires_grad_(False)` freezes them.

    Args:
        sample_rate_hz: Of commands and readings.
        amplifier: Arguments of `Amplifier`, which see; None is ideal.
        actuator: Arguments of `Actuator`; None is 1 µm/V.
        mechanics: Arguments of `Mechanics`; None is rigid.
        sensor: Arguments of `Sensor`; None is ideal.
        seed: Of the noise.

    Raises:
        ConfigError: An unknown setting (with the nearest right one), or a value of the wrong kind.
        StageError: An unphysical value; names parameter, value, unit and what is wanted.
    """

    quantities: ClassVar[dict[str, Quantity]] = {
        "sample_rate_hz": Quantity("Hz", at_least=0, positive=True),
        "seed": Quantity("", at_least=0),
    }
    amplifier: Amplifier
    actuator: Actuator
    mechanics: Mechanics
    sensor: Sensor

    def __init__(
        self,
        *,
        sample_rate_hz: float,
        amplifier: Mapping[str, Any] | None = None,
        actuator: Mapping[str, Any] | None = None,
        mechanics: Mapping[str, Any] | None = None,
        sensor: Mapping[str, Any] | None = None,
        seed: int = 0,
    ) -> None:
        rate_hz = self.quantities["sample_rate_hz"].check("sample_rate_hz", sample_rate_hz)
        period_s = 1.0 / rate_hz
        super().__init__(
            amplifier=build(Amplifier, amplifier, "amplifier", period_s),
            actuator=build(Actuator, actuator, "actuator", period_s),
            mechanics=build(Mechanics, mechanics, "mechanics", period_s),
        )
        self.sensor = build(Sensor, sensor, "sensor", period_s)
        self.sample_rate_hz = rate_hz
        self.sample_period_s = period_s
        self.seed = int(self.quantities["seed"].check("seed", seed))

    @classmethod
    def from_yaml(cls, path: str | Path) -> "Stage":
        """The stage in a file such as `configs/stage/default.yaml`; errors name the file."""
        return cls.from_dict(read_yaml(path), str(path))

    @classmethod
    def from_dict(
        cls,
        settings: Mapping[str, Any],
        source: str = "stage",  # what errors name
    ) -> "Stage":
        """The stage of these settings, which are the constructor's arguments and stand in the file."""
        try:
            return build(cls, settings)
        except (ConfigError, StageError) as error:
            raise type(error)(f"{source}: {error}") from error

    def to_dict(self) -> dict[str, Any]:
        """Plain settings with the present values of the parameters: `from_dict` gives this stage again."""
        return {
            "sample_rate_hz": self.sample_rate_hz,
            "seed": self.seed,
            "amplifier": self.amplifier.settings(),
            "actuator": self.actuator.settings(),
            "mechanics": self.mechanics.settings(),
            "sensor": self.sensor.settings(),
        }

    def at_sample_rate(self, sample_rate_hz: float) -> "Stage":
        """The same physics, commanded and read at another rate. Parameters are copied."""
        return type(self).from_dict({**self.to_dict(), "sample_rate_hz": sample_rate_hz})

    @property
    def min_voltage_v(self) -> float:
        """Lower limit of the voltage; -inf for none."""
        return self.amplifier.clip.low

    @property
    def max_voltage_v(self) -> float:
        """Upper limit of the voltage; inf for none."""
        return self.amplifier.clip.high

    def simulate(
        self,
        u: Tensor,  # (batch, time), V
        seed: int | None = None,  # of the noise; the stage's own by default
    ) -> tuple[Tensor, Tensor]:  # (batch, time), µm, twice
        """Displacement, and what the sensor reads of it, from the de-energised state.

        Converters and noise are in. Each row has its own noise, the same in every call.

        Raises:
            StageError: Another shape than (batch, time), a command that is not finite, or a delay that is
                longer than the record.
        """
        if u.ndim != 2:
            raise StageError(f"u: found shape {tuple(u.shape)}, want (batch, time)")
        finite = torch.isfinite(u)
        if not bool(finite.all()):
            row, sample = torch.nonzero(~finite)[0].tolist()
            found = f"{u[row, sample].item()} V in row {row}, sample {sample}"
            raise StageError(f"u: found {found}, want finite numbers")
        delay_s, duration_s = self.amplifier.lag.delay_s.item(), u.shape[1] * self.sample_period_s
        if delay_s >= duration_s:
            raise StageError(
                f"amplifier.delay_s: found {delay_s:g} s, want less than the record, {duration_s:g} s"
            )
        commands, _ = self.amplifier.converter(u.to(torch.float64))
        y, _ = self(commands)
        return y, self.sensor.measure(y, white_noise(self.seed if seed is None else seed, *u.shape))

    def stream(self, compiled: bool = True) -> StageStream:  # type: ignore[override]
        """The rig sample by sample, with the parameters of now: `reset(seed)`, `step(u)` → (y, reading).

        The same numbers as row 0 of `simulate`, to the last bit.

        Args:
            compiled: Whether TorchScript compiles the step: about a second once, then the faster way.
        """
        sensor = self.sensor
        rig = RigStream(
            self.amplifier.converter.stream(), super().stream(), sensor.stream(), sensor.noise_um,
            sensor.converter.stream(),
        )  # fmt: skip
        return StageStream(rig, self.seed, compiled)
