"""What every reader offers: the names in the file, the numbers under a name, and where a number stands."""

import difflib
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable
from importlib import import_module
from typing import Any

import numpy as np

from torchpi.errors import RecordingError
from torchpi.recordings.readers.header import LONGEST_NAME, stated_unit, stem_and_unit

Column = str | int  # a name, or a number counted from 1


class Source(ABC):
    """An open file of signals."""

    has_times = False
    """Does the format keep time stamps beside its signals? Then `times` gives them."""

    def __init__(self, path: str, names: list[str]) -> None:
        self.path = path
        self.names = names
        self.units: dict[str, str] = {}
        """Units that the file states beside the names of its columns."""

    @abstractmethod
    def read(self, names: list[str]) -> list[np.ndarray]:
        """The signals under these names (each one given by `find`), (time,) float64."""

    def place(self, index: int) -> str:
        """Where sample `index` stands, as the user counts it."""
        return f"sample {index + 1}"

    def unit(self, name: str) -> str | None:
        """The unit that the file states for this column, in its name or beside it; None where it has none."""
        indexed = INDEXED.fullmatch(name)
        return self.units.get(name) or stem_and_unit(indexed["name"] if indexed else name)[1]

    def holds_numbers(self, name: str) -> bool:
        """Is this column worth reading? A text's column of words is not."""
        return True

    def find(self, column: Column, option: str) -> str:
        """The name in the file that `column` means.

        Raises RecordingError, with the nearest name and the list of all, if there is none.
        """
        name = str(column)
        if name in self.names:
            return name
        if name.isdigit() and 1 <= int(name) <= len(self.names):
            return self.names[int(name) - 1]
        if self._offers(name):
            return name
        without_unit = [other for other in self.names if _without_unit(other) == name]
        if len(without_unit) == 1:
            return without_unit[0]
        guess = nearest(name, self.names)
        raise RecordingError(
            f"{self.path}: no column '{name}' ({option}); "
            + (f"the nearest is '{guess}'; " if guess else "")
            + f"the file has: {shortened(self.names)}; choose one with the option {option}"
        )

    def scalar(self, name: str) -> float | None:
        """A single number stored under this name, None where the format or the file has none."""
        return None

    def times(self, name: str) -> np.ndarray | None:
        """The time stamps that the format keeps for this signal (time,), s; None where it keeps none."""
        return None

    def _offers(self, name: str) -> bool:
        return False


class ArraySource(Source):
    """A file of named arrays. A name may carry an index, `u[:,0,0]`, that makes one signal of many."""

    @abstractmethod
    def array(self, name: str) -> Any:
        """What is stored under this name, as it is."""

    def read(self, names: list[str]) -> list[np.ndarray]:
        return [self._signal(name) for name in names]

    def scalar(self, name: str) -> float | None:
        if name not in self.names:
            return None
        value = np.asarray(self.array(name))
        return float(value.reshape(-1)[0]) if value.size == 1 and value.dtype.kind in "fiu" else None

    def _offers(self, name: str) -> bool:
        match = INDEXED.fullmatch(name)
        return match is not None and match["name"] in self.names

    def _signal(self, name: str) -> np.ndarray:
        match = None if name in self.names else INDEXED.fullmatch(name)
        stored = np.asarray(self.array(match["name"] if match else name))
        if stored.dtype.kind not in "fiu":
            raise RecordingError(
                f"{self.path}: '{name}' holds {stored.dtype}, expected numbers; choose another name"
            )
        if match:
            try:
                stored = stored[_index(match["index"])]
            except (IndexError, ValueError):
                shape = "×".join(map(str, stored.shape))
                raise RecordingError(
                    f"{self.path}: '{name}': the index does not fit the array of {shape}; "
                    f"expected one of the kind {match['name']}[{_example(stored.shape)}]"
                ) from None
        stored = np.squeeze(stored)
        if stored.ndim > 1:
            shape, plain = "×".join(map(str, stored.shape)), match["name"] if match else name
            raise RecordingError(
                f"{self.path}: '{name}' is an array of {shape}, expected one signal; "
                f"choose one with an index, as in {plain}[{_example(stored.shape)}]"
            )
        return np.ascontiguousarray(np.atleast_1d(stored), dtype=np.float64)


INDEXED = re.compile(r"(?P<name>.+)\[(?P<index>[-\d:,\s]+)\]")


def _without_unit(name: str) -> str:
    """`Command` of `Command [mV]`, as it is spelled."""
    match = re.fullmatch(r"(.{1,200}?)\s*[\[(][^\])]*[\])]\s*", name)
    return match[1] if match and stated_unit(name[match.end(1) :].strip(" []()")) else name


def nearest(name: str, names: Iterable[str]) -> str | None:
    """The name that a misspelled one probably means, whatever its case."""
    by_lower = {other.lower(): other for other in names if len(other) <= LONGEST_NAME}
    found = difflib.get_close_matches(name[:LONGEST_NAME].lower(), by_lower, n=1, cutoff=0.5)
    return by_lower[found[0]] if found else None


def shortened(names: list[str], most: int = 20) -> str:
    """The names on one line; of a long list the first ones, and how many more there are."""
    rest = f", and {len(names) - most} more" if len(names) > most else ""
    return (
        ", ".join(name if len(name) <= 60 else f"{name[:57]}…" for name in names[:most]) + rest
    ) or "nothing"


def stated_units(pairs: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Units by column, of pairs of a name and what the file writes as its unit."""
    stated = ((name, stated_unit(text)) for name, text in pairs)
    return {name: unit for name, unit in stated if unit is not None}


def reason_of(error: Exception) -> str:
    """A library's error message, short and on one line."""
    return " ".join(str(error).split())[:200] or type(error).__name__


def import_extra(path: str, module: str) -> Any:
    """The module that reads this format; where it is missing, RecordingError with the line to install it."""
    try:
        return import_module(module)
    except ImportError:
        raise RecordingError(
            f"{path}: reading this format needs {module}; run: pip install 'torchpi[io]'"
        ) from None


def _index(text: str) -> tuple[int | slice, ...]:
    return tuple(
        slice(*(int(edge) if edge.strip() else None for edge in part.split(":")))
        if ":" in part
        else int(part)
        for part in text.split(",")
    )


def _example(shape: tuple[int, ...]) -> str:
    """An index that takes one signal along the longest axis."""
    time = int(np.argmax(shape)) if shape else 0
    return ",".join(":" if axis == time else "0" for axis in range(max(1, len(shape))))
