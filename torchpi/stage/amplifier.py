"""First block: the command, as a number, to the voltage that drives the actuator.

Voltages are those on the controller's side; the fixed gain of the amplifier is part of the actuator's.
"""

import math

from torchpi.operators.held_lag import HeldLag
from torchpi.operators.limits import Clip
from torchpi.operators.quantity import check_order
from torchpi.stage.chain import Chain
from torchpi.stage.converter import Converter


class Amplifier(Chain):
    """D/A converter, saturation, then the held, delayed and lagged voltage. Given nothing, it only holds.

    `forward` leaves the converter out, which only `Stage.simulate` and streams use.

    Args:
        sample_period_s: T.
        min_voltage_v: Lower saturation; None is no limit.
        max_voltage_v: Upper saturation; None is no limit.
        cutoff_hz: Of the first-order lag; None is no lag.
        delay_s: Computation and converter together, beyond the hold itself.
        converter_bits: Resolution of the converter; None is ideal.
        converter_min_v: Lower end of its range.
        converter_max_v: Upper end of its range.

    Raises:
        StageError: An unphysical value.
    """

    clip: Clip
    lag: HeldLag

    def __init__(
        self,
        sample_period_s: float,
        *,
        min_voltage_v: float | None = None,
        max_voltage_v: float | None = None,
        cutoff_hz: float | None = None,
        delay_s: float = 0.0,
        converter_bits: int | None = None,
        converter_min_v: float = -10.0,
        converter_max_v: float = 10.0,
    ) -> None:
        low = -math.inf if min_voltage_v is None else min_voltage_v
        high = math.inf if max_voltage_v is None else max_voltage_v
        check_order("min_voltage_v", low, "max_voltage_v", high, "V")
        super().__init__(clip=Clip(low, high), lag=HeldLag(sample_period_s, cutoff_hz, delay_s))
        self.converter = Converter(converter_bits, converter_min_v, converter_max_v, "v")

    def settings(self) -> dict[str, object]:
        """What the constructor takes, with the present values."""
        cutoff_hz = self.lag.cutoff_hz
        return {
            "min_voltage_v": self.clip.low if math.isfinite(self.clip.low) else None,
            "max_voltage_v": self.clip.high if math.isfinite(self.clip.high) else None,
            "cutoff_hz": None if cutoff_hz is None else cutoff_hz.item(),
            "delay_s": self.lag.delay_s.item(),
            **self.converter.settings(),
        }
