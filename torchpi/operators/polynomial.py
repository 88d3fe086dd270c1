"""The polynomial saturation operator, Qin et al. (2013), eq. 4."""

import torch
from torch import Tensor, nn

from torchpi.errors import ConfigError, is_positive
from torchpi.operators.base import Static, StaticStream


def polynomial(x: float, c: list[float]) -> float:
    """Return S(x) = c_m x^m + … + c_1 x by Horner's rule; `c` is c_1 first. There is no constant term.

    This is eq. 4. It also accepts tensors: batch and stream run this one function.

    Args:
        x: Input, in any unit.
        c: c_1 first; c_i in the unit of the output, per unit of x to the i.

    Example:
        >>> from torchpi.operators import polynomial
        >>> polynomial(2.0, [1.0, -0.05])  # 2 - 0.05 · 2²
        1.8
    """
    s = 0.0
    for i in range(len(c) - 1, -1, -1):
        s = horner(s, c[i], x)
    return s


def horner(s: float, c: float, x: float) -> float:
    """One step of Horner's rule, which the kernels compile."""
    return (s + c) * x


class Polynomial(Static):
    """Saturation operator: a polynomial without constant term, memoryless.

    Args:
        coefficients: c_1 first, c_m last.
        scale: A typical size of the input. The trained numbers are c_i scale^(i-1), which are then of
            similar size for all i; `c` gives the coefficients themselves.

    Raises:
        ConfigError: No coefficient, one that is not finite, or a scale that is not positive.

    Example:
        >>> import torch
        >>> from torchpi import Polynomial
        >>> y, _ = Polynomial([1.0, -0.05])(torch.tensor([[1.0, 2.0]], dtype=torch.float64))
        >>> y.tolist()
        [[0.95, 1.8]]
    """

    def __init__(self, coefficients: list[float], scale: float = 1.0) -> None:
        super().__init__()
        try:
            c = torch.as_tensor(coefficients, dtype=torch.float64)
        except (TypeError, ValueError, RuntimeError):
            c = torch.zeros(0, dtype=torch.float64)
        if c.ndim != 1 or len(c) == 0 or not bool(torch.isfinite(c).all()):
            raise ConfigError(f"coefficients: found {coefficients!r}, expected at least one, all finite")
        if not is_positive(scale):
            raise ConfigError(f"scale: found {scale!r}, expected a positive number")
        self.powers: Tensor
        self.register_buffer("powers", scale ** torch.arange(len(c), dtype=torch.float64))
        self.scaled = nn.Parameter(c * self.powers)

    @property
    def c(self) -> Tensor:
        """Coefficients c_1 … c_m, (degree,)."""
        return self.scaled / self.powers

    def set_coefficients(self, c: Tensor) -> None:
        """Replace c_1 … c_m, (degree,), c_i in the unit of the output per unit of the input to the i."""
        with torch.no_grad():
            self.scaled.copy_(c * self.powers)

    def of(self, x: Tensor) -> Tensor:
        s: Tensor = polynomial(x, list(self.c.to(x.dtype)))  # type: ignore
        return s

    def stream(self) -> "PolynomialStream":
        return PolynomialStream(self.c.tolist())

    def extra_repr(self) -> str:
        return f"degree={len(self.scaled)}"


class PolynomialStream(StaticStream):
    """The saturation operator, one sample at a time."""

    c: list[float]

    def __init__(self, c: list[float]) -> None:
        super().__init__()
        self.c = c

    @torch.jit.export
    def step(self, x: float) -> float:
        return polynomial(x, self.c)
