"""A figure that a page quotes, and a measurement that yields several figures."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

SHORT_S = 20.0
"""The tests repeat measurements that take less time than this."""


@dataclass(frozen=True)
class Figure:
    """A number, its bound, and how the pages print it.

    Attributes:
        name: Unique among all figures; a quotation on a page refers to it.
        unit: `1` for ratios and counts.
        at_least, at_most: The stated bound, in `unit`.
        digits: Format in which the pages quote it.
    """

    name: str
    unit: str
    at_least: float
    at_most: float
    digits: str = ".3g"

    def within(self, value: float) -> bool:
        """Whether a value lies in the bound; NaN does not."""
        return self.at_least <= value <= self.at_most

    def quoted(self, value: float) -> str:
        """The value as a page prints it, without its unit."""
        return format(value, self.digits)

    @property
    def bound(self) -> str:
        return f"{self.at_least:g} to {self.at_most:g}{self.unit_behind}"

    @property
    def unit_behind(self) -> str:
        """The unit as printed behind a number; empty for ratios and counts."""
        return "" if self.unit == "1" else f" {self.unit}"


@dataclass(frozen=True)
class Measurement:
    """One command, and the figures that are read from its results.

    Attributes:
        name: Name for `--only`.
        command: What a person types to measure it.
        figures: The figures it yields.
        measure: Runs the command; returns the values of the figures by their names.
        about_s: Seconds on one core of a server of 2020, kernels compiled.
        needs_recordings: Whether it reads the public recordings of real stages beside the checkout.
    """

    name: str
    command: str
    figures: tuple[Figure, ...]
    measure: Callable[[], Mapping[str, float]]
    about_s: float
    needs_recordings: bool = False

    @property
    def short(self) -> bool:
        return self.about_s < SHORT_S

    def values(self) -> dict[str, float]:
        """Run the measurement and return the values of its figures by name.

        Raises:
            ValueError: It returned other figures than were registered.
        """
        found = dict(self.measure())
        expected = {figure.name for figure in self.figures}
        if found.keys() != expected:
            raise ValueError(f"{self.name}: found {sorted(found)}, expected {sorted(expected)}")
        return found
