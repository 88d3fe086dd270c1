"""What every item of the reproduction gives: its part of results.json, and rows beside the paper's."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Row:
    """One number beside the paper's.

    Attributes:
        what: In words.
        ours: What came out.
        unit: Of both; empty for a bare number.
        paper: The paper's number, or the one recomputed from its text; None if it gives none.
        at_most: What `ours` must not exceed, if it has such a bound.
        within_percent: How far `ours` may be from `paper`, if it has such a bound.
        note: What a reader needs to compare the two.
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
        """Ours less the paper's."""
        return None if self.paper is None else self.ours - self.paper

    @property
    def difference_percent(self) -> float | None:
        """The same, of the paper's."""
        return None if not self.paper else 100 * (self.ours - self.paper) / abs(self.paper)

    @property
    def met(self) -> bool | None:
        """Whether the bounds are kept; None without any."""
        kept = []
        if self.at_most is not None:
            kept.append(self.ours <= self.at_most)
        if self.within_percent is not None and self.difference_percent is not None:
            kept.append(abs(self.difference_percent) <= self.within_percent)
        return all(kept) if kept else None


class Result:
    """What an item found: a frozen dataclass."""

    def numbers(self) -> dict[str, Any]:
        """Its part of results.json: nested, every key a string."""
        raise NotImplementedError

    def rows(self) -> list[Row]:
        """Its table."""
        return []
