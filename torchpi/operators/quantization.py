"""Rounding to equidistant levels: q(x) = o + s · clip(round((x - o) / s)), and the converter that does it.

Widrow and Kollár, *Quantization Noise*, 2008.
"""

import math
from typing import Any, ClassVar, cast

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from torchpi.errors import StageError
from torchpi.operators.base import Static, StepStream
from torchpi.operators.limits import clip
from torchpi.operators.quantity import Quantity


def quantize(x: float, offset: float, step: float, first: float, last: float) -> float:
    """Return offset + step · code, with the nearest code of first … last; halves round up."""
    return offset + step * clip(float(math.floor((x - offset) / step + 0.5)), first, last)


class Quantize(torch.autograd.Function):
    """`quantize` over whole records.

    Straight-through estimator: the gradient for x is 1 inside the range and 0 beyond, as if there were no
    steps; those for offset and step are 0.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor, offset: Tensor, step: Tensor, first: float, last: float) -> Tensor:
        code = torch.floor((x - offset) / step + 0.5)
        ctx.save_for_backward((code >= first) & (code <= last), offset, step)
        return offset + step * code.clamp(first, last)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        inside, offset, step = ctx.saved_tensors
        return gradients[0] * inside, torch.zeros_like(offset), torch.zeros_like(step), None, None


def quantize_step(x: float, n: list[float], s: list[float]) -> float:
    """`quantize` in the form a stream calls: n holds its other arguments."""
    return quantize(x, n[0], n[1], n[2], n[3])


class Converter(Static):
    """A D/A or A/D converter: 2^bits levels that divide its range.

    Args:
        bits: Resolution.
        low: Value of code 0, unit of the input.
        high: Upper end of the range; the last code is one step below it.

    Raises:
        StageError: Fewer than 1 or more than 32 bits, or a range out of order.

    Example:
        >>> import torch
        >>> from torchpi.operators import Converter
        >>> read, _ = Converter(bits=8, low=0.0, high=10.0)(torch.tensor([[1.0, 12.0]], dtype=torch.float64))
        >>> read.tolist()
        [[1.015625, 9.9609375]]
    """

    quantities: ClassVar[dict[str, Quantity]] = {"bits": Quantity("bits", at_least=1, at_most=32)}

    def __init__(self, bits: int, low: float, high: float) -> None:
        super().__init__()
        self.bits = int(self.quantities["bits"].check("bits", bits))
        if not -math.inf < low < high < math.inf:
            raise StageError(f"high: found {high:g}, expected a finite number above low = {low:g}")
        self.low = float(low)
        self.high = float(high)
        self.last_code = 2.0**self.bits - 1.0
        self.step_size = (self.high - self.low) / 2.0**self.bits

    def of(self, x: Tensor) -> Tensor:
        offset, step = (torch.tensor(value, dtype=x.dtype) for value in (self.low, self.step_size))
        return cast(Tensor, Quantize.apply(x, offset, step, 0.0, self.last_code))

    def stream(self) -> nn.Module:
        return StepStream(quantize_step, [self.low, self.step_size, 0.0, self.last_code])

    def settings(self) -> dict[str, float]:
        """Return the constructor's arguments."""
        return {"bits": self.bits, "low": self.low, "high": self.high}

    def extra_repr(self) -> str:
        return f"{self.bits} bits over {self.low:g} … {self.high:g}"
