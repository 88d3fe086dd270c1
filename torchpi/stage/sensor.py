"""Last block: displacement of the platform to the number that the controller reads."""

from typing import ClassVar

from torch import Tensor

from torchpi.operators.lag import Lag
from torchpi.operators.quantity import Quantity
from torchpi.stage.chain import Chain
from torchpi.stage.converter import Converter


class Sensor(Chain):
    """A lag, white noise, and an A/D converter. Given nothing, it reads the displacement itself.

    `forward` is the lag alone; `measure` is all of it.

    Args:
        sample_period_s: T.
        cutoff_hz: Of the first-order lag; None is no lag.
        noise_um: Standard deviation of the noise of one reading.
        converter_bits: Resolution of the converter; None is ideal.
        converter_min_um: Lower end of its range.
        converter_max_um: Upper end of its range.

    Raises:
        StageError: An unphysical value.
    """

    quantities: ClassVar[dict[str, Quantity]] = {"noise_um": Quantity("µm", at_least=0)}
    lag: Lag | None

    def __init__(
        self,
        sample_period_s: float,
        *,
        cutoff_hz: float | None = None,
        noise_um: float = 0.0,
        converter_bits: int | None = None,
        converter_min_um: float = -50.0,
        converter_max_um: float = 50.0,
    ) -> None:
        super().__init__(lag=None if cutoff_hz is None else Lag(sample_period_s, cutoff_hz))
        self.noise_um = self.quantities["noise_um"].check("noise_um", noise_um)
        self.converter = Converter(converter_bits, converter_min_um, converter_max_um, "um")

    def measure(
        self,
        y: Tensor,  # (batch, time), µm
        noise: Tensor,  # (batch, time), of unit variance
    ) -> Tensor:  # (batch, time), µm
        """The readings of a displacement, from rest at 0."""
        reading, _ = self(y)
        read: Tensor = self.converter(reading + self.noise_um * noise)[0]
        return read

    def settings(self) -> dict[str, object]:
        """What the constructor takes, with the present values."""
        return {
            "cutoff_hz": None if self.lag is None else self.lag.cutoff_hz.item(),
            "noise_um": self.noise_um,
            **self.converter.settings(),
        }
