"""The motions and voltages that a compensator was trained on: beyond them it extrapolates."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Protocol

import torch
from torch import Tensor

from torchpi.errors import ConfigError
from torchpi.operators.motion import Motion

Interval = tuple[float, float]


class Pair(Protocol):
    """A record from displacement to voltage, as an inverse needs it, such as `identification.InversePair`."""

    @property
    def motion(self) -> Motion: ...  # (1, time)
    @property
    def u(self) -> Tensor: ...  # (1, time), V
    @property
    def counted(self) -> slice: ...
    @property
    def sample_period_s(self) -> float: ...


@dataclass(frozen=True)
class TrainedMotions:
    """Least and largest values over the samples that counted in training.

    Attributes:
        range_um: Displacement, µm.
        rates_um_s: Signed rate of the displacement, µm/s.
        voltages_v: Voltage, V.
        voltage_rates_v_s: Change of the voltage from sample to sample over the sample period, V/s.
        accelerations_um_s2: Acceleration of the displacement, µm/s²; None in files of earlier versions.
    """

    range_um: Interval
    rates_um_s: Interval
    voltages_v: Interval
    voltage_rates_v_s: Interval
    accelerations_um_s2: Interval | None = None

    @classmethod
    def of(cls, pairs: Iterable[Pair]) -> "TrainedMotions":
        """Return the ranges of the records that a compensator is trained on."""
        y, rates, u, changes, accelerations = [], [], [], [], []
        for pair in pairs:
            y.append(pair.motion.yd[0, pair.counted])
            rates.append(pair.motion.yd_dot[0, pair.counted])
            u.append(pair.u[0, pair.counted])
            changes.append(u[-1].diff() / pair.sample_period_s)
            accelerations.append(pair.motion.yd_ddot[0, pair.counted])
        return cls(*(_interval(torch.cat(part)) for part in (y, rates, u, changes, accelerations)))

    @classmethod
    def from_plain(cls, values: Mapping[str, Sequence[float] | None]) -> "TrainedMotions":
        """Rebuild an instance from the result of `plain`.

        Raises:
            ConfigError: An unexpected key, or a value that is no interval of finite numbers.
        """
        names = set(cls.__dataclass_fields__)
        if not isinstance(values, Mapping) or set(values) | {"accelerations_um_s2"} != names:
            found = sorted(values) if isinstance(values, Mapping) else type(values).__name__
            raise ConfigError(f"trained: found {found}, expected {', '.join(sorted(names))}")
        intervals = {}
        for name, value in values.items():
            if value is None and name == "accelerations_um_s2":
                continue
            ends = [float(end) for end in value] if isinstance(value, Sequence) else []
            interval = torch.tensor(ends, dtype=torch.float64)
            if len(interval) != 2 or not bool(torch.isfinite(interval).all()) or interval[0] > interval[1]:
                raise ConfigError(f"trained.{name}: found {value}, expected two finite numbers in order")
            intervals[name] = (interval[0].item(), interval[1].item())
        return cls(**intervals)

    def lead_limits(self, lead: Sequence[float]) -> Interval | None:
        """Return the least and largest τ_1 ẏ + τ_2 ÿ, µm, for these rates and accelerations or zero ones.

        Args:
            lead: τ_1 in s, τ_2 in s².

        Returns:
            None if the accelerations are not known.
        """
        if self.accelerations_um_s2 is None:
            return None
        least, largest = 0.0, 0.0
        for tau, interval in zip(lead, (self.rates_um_s, self.accelerations_um_s2), strict=False):
            ends = [tau * end for end in (0.0, *interval)]
            least, largest = least + min(ends), largest + max(ends)
        return least, largest

    def plain(self) -> dict[str, Any]:
        """Return lists of numbers by name, as hyper-parameters and JSON store them."""
        return {name: None if value is None else list(value) for name, value in asdict(self).items()}


def _interval(values: Tensor) -> Interval:
    return values.min().item(), values.max().item()
