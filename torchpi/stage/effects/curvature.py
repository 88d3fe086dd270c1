"""A memoryless curvature of slope 1 at 0: y = x + c₂x² + c₃x³."""

from torch import Tensor, nn

from torchpi.operators.base import Static
from torchpi.operators.polynomial import PolynomialStream, polynomial
from torchpi.stage.effects.effect import DataRange, Effect, Parameters


class Curvature(Static, Effect):
    """Its two parameters are c₂ and c₃, in the order of `quantities`."""

    def of(self, x: Tensor) -> Tensor:
        c = [1.0, *(getattr(self, name) for name in self.quantities)]
        y: Tensor = polynomial(x, c)  # type: ignore
        return y

    def stream(self) -> nn.Module:
        return PolynomialStream([1.0, *self.values().values()])

    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        c2, c3 = self.values().values()
        return (1 + (2 * c2 + 3 * c3 * x.detach()) * x.detach()) * dx

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        span = seen.span_v if cls.before_hysteresis else seen.span_um
        if span == 0:
            return []
        # One per cent at the end of the range.
        square, cube = ({name: 0.01 / span**power} for power, name in enumerate(cls.quantities, 1))
        return [square, cube, square | cube]
