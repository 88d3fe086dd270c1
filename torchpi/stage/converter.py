"""The D/A and A/D converters at the two ends."""

from torchpi.operators.quantity import check_order
from torchpi.operators.quantization import Quantization
from torchpi.stage.chain import Chain


class Converter(Chain):
    """A quantisation, or nothing if ideal.

    Args:
        bits: Resolution; None is ideal.
        low: Lower end of the range.
        high: Upper end of the range.
        unit: "v" or "um", as the names of the parameters end.

    Raises:
        StageError: An unphysical value, under the name that it has in the stage's file.
    """

    quantization: Quantization | None

    def __init__(self, bits: int | None, low: float, high: float, unit: str) -> None:
        if bits is None:
            super().__init__(quantization=None)
        else:
            Quantization.quantities["bits"].check("converter_bits", bits)
            low_name, high_name = f"converter_min_{unit}", f"converter_max_{unit}"
            check_order(low_name, low, high_name, high, {"v": "V", "um": "µm"}[unit])
            super().__init__(quantization=Quantization(bits, low, high))
        self.unit = unit

    def settings(self) -> dict[str, object]:
        """The parameters as they stand in the stage's file."""
        if self.quantization is None:
            return {}
        return {
            "converter_bits": self.quantization.bits,
            f"converter_min_{self.unit}": self.quantization.low,
            f"converter_max_{self.unit}": self.quantization.high,
        }
