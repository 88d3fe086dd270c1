"""Result of an item of the reproduction: its part of results.json, and rows compared with the paper."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Row:
    """One number compared with the paper's.

    Attributes:
        what: Description of the number.
        ours: The number obtained here.
        unit: Unit of both numbers; empty for a dimensionless number.
        paper: Number of the paper, or recomputed from its text; None if the paper gives none.
        at_most: Upper bound of `ours`, if there is one.
        within_percent: Permitted deviation of `ours` from `paper`, if there is such a bound.
        note: Remark that a reader needs to compare the two.
    """

    what: str
    ours: float
    unit: str = ""
    paper: float | None = None
    at_most: float | None = None
    within_percent: float | None = None
    note: str = ""

    @property
    def difference(self) -> float | None:
        """Our number minus the paper's."""
        return None if self.paper is None else self.ours - self.paper

    @property
    def difference_percent(self) -> float | None:
        """The difference in per cent of the paper's number."""
        return None if not self.paper else 100 * (self.ours - self.paper) / abs(self.paper)

    @property
    def met(self) -> bool | None:
        """Whether the bounds are met; None if there are none."""
        kept = []
        if self.at_most is not None:
            kept.append(self.ours <= self.at_most)
        if self.within_percent is not None and self.difference_percent is not None:
            kept.append(abs(self.difference_percent) <= self.within_percent)
        return all(kept) if kept else None


class Result:
    """Base class of the results of items, which are frozen dataclasses."""

    def numbers(self) -> dict[str, Any]:
        """Return the part of results.json: nested dictionaries, every key a string."""
        raise NotImplementedError

    def rows(self) -> list[Row]:
        """Return the rows of the table."""
        return []
