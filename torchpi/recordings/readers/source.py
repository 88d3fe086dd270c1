"""Interface of all readers: the names in a file, the numbers under a name, and the place of a sample."""

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
    """Whether the format stores time stamps beside its signals; if so, `times` returns them."""

    def __init__(self, path: str, names: list[str]) -> None:
        self.path = path
        self.names = names
        self.units: dict[str, str] = {}
        """Units that the file states separately from the column names."""

    @abstractmethod
    def read(self, names: list[str]) -> list[np.ndarray]:
        """Return the signals under these names (each from `find`), (time,) float64."""

    def place(self, index: int) -> str:
        """Describe where sample `index` stands, as the user counts it."""
        return f"sample {index + 1}"

    def unit(self, name: str) -> str | None:
        """Return the unit stated for this column, in its name or separately; None if there is none."""
        indexed = INDEXED.fullmatch(name)
        return self.units.get(name) or stem_and_unit(indexed["name"] if indexed else name)[1]

    def holds_numbers(self, name: str) -> bool:
        """Whether this column can be read as numbers; a text column cannot."""
        return True

    def find(self, column: Column, option: str) -> str:
        """Return the name in the file that `column` refers to.

        Raises RecordingError, with the nearest name and a list of all, if there is none.
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
        """Return the single number stored under this name; None if the format or the file has none."""
        return None

    def times(self, name: str) -> np.ndarray | None:
        """Return the time stamps that the format stores for this signal (time,), s, or None."""
        return None

    def _offers(self, name: str) -> bool:
        return False


class ArraySource(Source):
    """A file of named arrays; a name may have an index, `u[:,0,0]`, that selects one signal."""

    @abstractmethod
    def array(self, name: str) -> Any:
        """Return what is stored under this name, unchanged."""

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
                    f"expected an index such as {match['name']}[{_example(stored.shape)}]"
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
    """Return the name without its unit, spelling kept: `Command` for `Command [mV]`."""
    match = re.fullmatch(r"(.{1,200}?)\s*[\[(][^\])]*[\])]\s*", name)
    return match[1] if match and stated_unit(name[match.end(1) :].strip(" []()")) else name


def nearest(name: str, names: Iterable[str]) -> str | None:
    """Return the name that a misspelled one probably means, ignoring case."""
    by_lower = {other.lower(): other for other in names if len(other) <= LONGEST_NAME}
    found = difflib.get_close_matches(name[:LONGEST_NAME].lower(), by_lower, n=1, cutoff=0.5)
    return by_lower[found[0]] if found else None


def shortened(names: list[str], most: int = 20) -> str:
    """Return the names on one line; of a long list, the first ones and the number of the rest."""
    rest = f", and {len(names) - most} more" if len(names) > most else ""
    return (
        ", ".join(name if len(name) <= 60 else f"{name[:57]}…" for name in names[:most]) + rest
    ) or "nothing"


def stated_units(pairs: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Return units by column, from pairs of a column name and the text that the file gives as its unit."""
    stated = ((name, stated_unit(text)) for name, text in pairs)
    return {name: unit for name, unit in stated if unit is not None}


def reason_of(error: Exception) -> str:
    """Return a library's error message, shortened to one line."""
    return " ".join(str(error).split())[:200] or type(error).__name__


def import_extra(path: str, module: str) -> Any:
    """Import the module that reads this format; raise RecordingError with the install command if missing."""
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
    """Return an example index that selects one signal along the longest axis."""
    time = int(np.argmax(shape)) if shape else 0
    return ",".join(":" if axis == time else "0" for axis in range(max(1, len(shape))))
