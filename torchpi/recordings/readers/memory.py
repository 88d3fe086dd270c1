"""Reader of signals in memory, arrays or the columns of a frame, with the same checks as a file."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from torchpi.errors import RecordingError, kind_of
from torchpi.recordings.readers.iso_time import is_stamp, seconds_of
from torchpi.recordings.readers.source import ArraySource


class MemorySource(ArraySource):
    """Copies of arrays by name. Dates and time differences become seconds from the first.

    Args:
        name: Name in error messages.
        arrays: Anything that NumPy can convert to an array, by name.
        position: Word for the position of a sample, counted from 0: `index`, or `iloc` for a frame.
    """

    def __init__(self, name: str, arrays: Mapping[str, Any], position: str = "index") -> None:
        super().__init__(name, list(arrays))
        self._arrays, self._position = arrays, position
        self.units = {key: "s" for key, values in arrays.items() if _kind(values) in ("m", "M")}

    def place(self, index: int) -> str:
        return f"{self._position} {index}"

    def array(self, name: str) -> np.ndarray:
        values = self._arrays[name]
        try:
            if isinstance(values, np.ma.MaskedArray):
                return np.ma.filled(values.astype(np.float64), np.nan)
            found = np.asarray(values).copy()
        except Exception as error:  # ragged lists, tensors that need a gradient: each library has its own
            reason = str(error).partition("\n")[0]
            raise RecordingError(
                f"{self.path}: '{name}': found {kind_of(values)}, expected an array of numbers ({reason})"
            ) from error
        if found.ndim == 0 and found.dtype.kind == "O":
            raise RecordingError(
                f"{self.path}: '{name}': found {kind_of(values)}, expected an array of numbers"
            )
        if found.dtype.kind in "mM" and len(found):
            return np.asarray((found - found[0]) / np.timedelta64(1, "ns") * 1e-9)
        return found


def frame_columns(name: str, frame: Any) -> dict[str, Any]:
    """Return the columns of a pandas frame by name, with its index if that has a name or holds dates.

    Raises:
        RecordingError: If it is not a frame.
    """
    if not (hasattr(frame, "columns") and hasattr(frame, "index") and hasattr(frame, "__getitem__")):
        raise RecordingError(
            f"{name}: found {type(frame).__name__}, expected a frame with columns, such as pandas.DataFrame"
        )
    columns = {str(column): frame[column] for column in frame.columns}
    label = getattr(frame.index, "name", None)
    if label is not None or _kind(frame.index) in ("m", "M"):
        columns.setdefault("time" if label is None else str(label), frame.index)
    return {key: _as_numbers(values) for key, values in columns.items()}


def _as_numbers(values: Any) -> Any:
    """Convert a column as the text reader would: dates, time stamps and decimal commas become numbers."""
    if _kind(values) == "M":  # NumPy would convert dates with a time zone to objects
        return values.to_numpy("datetime64[ns]")
    cells = np.asarray(values)
    if cells.dtype.kind not in "OUT" or any(isinstance(cell, bool) for cell in cells.flat):
        return values
    words = [cell for cell in cells.flat if isinstance(cell, str)]
    try:
        if words and is_stamp(words[0]):
            return seconds_of(cells)
        plain = [cell.replace(",", ".") if isinstance(cell, str) else cell for cell in cells.flat]
        return np.array([np.nan if cell is None else float(cell) for cell in plain])
    except (TypeError, ValueError):  # words are refused later, if numbers are needed
        return values


def _kind(values: Any) -> str:
    """Return NumPy's kind letter for the type of an array or a column; empty for anything else."""
    return getattr(getattr(values, "dtype", None), "kind", "")
