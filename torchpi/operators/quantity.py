"""Unit and limits of a physical parameter, checked where its value enters."""

import math
from dataclasses import dataclass

from torchpi.errors import StageError


@dataclass(frozen=True)
class Quantity:
    """A physical parameter.

    Args:
        unit: The unit as written, "" for a ratio.
        at_least: Smallest value allowed.
        at_most: Largest value allowed.
        positive: Whether 0 itself is not allowed, `at_least` being 0.
        identity: The value at which the effect of the parameter is absent; it may lie beyond the limits.
    """

    unit: str
    at_least: float = -math.inf
    at_most: float = math.inf
    positive: bool = False
    identity: float = 0.0

    def check(self, name: str, value: float) -> float:
        """Return `value` as a float.

        Raises:
            StageError: It is not finite or outside the limits; names the parameter, unit, found, expected.
        """
        inside = self.at_least <= value <= self.at_most and not (self.positive and value <= 0)
        if not (math.isfinite(value) and inside):
            unit = f" {self.unit}" if self.unit else ""
            raise StageError(f"{name}: found {value:g}{unit}, expected {self.expected()}{unit}")
        return float(value)

    def nearest(self, value: float) -> float:
        """Return the value, or the limit that it lies beyond."""
        return min(max(value, self.at_least), self.at_most)

    def expected(self) -> str:
        """Return the limits in words."""
        if self.positive and math.isfinite(self.at_most):
            return f"more than 0 and at most {self.at_most:g}"
        if self.positive:
            return "a positive number of" if self.unit else "a positive number"
        if math.isfinite(self.at_least) and math.isfinite(self.at_most):
            return f"{self.at_least:g} to {self.at_most:g}"
        if math.isfinite(self.at_least):
            return f"at least {self.at_least:g}"
        if math.isfinite(self.at_most):
            return f"at most {self.at_most:g}"
        return "a finite number of" if self.unit else "a finite number"


def check_order(low_name: str, low: float, high_name: str, high: float, unit: str) -> None:
    """Raise `StageError` unless `low` is below `high`."""
    if not low < high:
        raise StageError(
            f"{high_name}: found {high:g} {unit}, expected more than {low_name} = {low:g} {unit}"
        )
