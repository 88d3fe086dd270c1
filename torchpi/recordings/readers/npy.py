"""Reader of one NumPy array (`numpy.save`): columns by number, or by name if the array is structured."""

import numpy as np

from torchpi.errors import RecordingError
from torchpi.recordings.readers.source import ArraySource, reason_of


def open_file(path: str) -> "NpySource":
    return NpySource(path)


class NpySource(ArraySource):
    """The columns of one array."""

    def __init__(self, path: str) -> None:
        try:
            with open(path, "rb") as file:
                stored = np.load(file, allow_pickle=False)
        except PermissionError:
            raise
        except (
            Exception
        ) as error:  # numpy lets any parser error through: ValueError, TokenError, MemoryError …
            raise RecordingError(
                f"{path}: is not a NumPy array ({reason_of(error)}); save it again"
            ) from None
        if not isinstance(stored, np.ndarray):
            raise RecordingError(f"{path}: is a NumPy archive; rename it to .npz")
        if stored.dtype.names:
            self.columns = {name: stored[name] for name in stored.dtype.names}
        elif stored.ndim in (1, 2):
            table = np.atleast_2d(stored)
            table = table if len(table) <= table.shape[1] else table.T  # time runs along the longer axis
            self.columns = {str(k): column for k, column in enumerate(table, start=1)}
        else:
            shape = "×".join(map(str, stored.shape))
            raise RecordingError(
                f"{path}: an array of {shape}, expected rows and columns; save a two-dimensional array"
            )
        super().__init__(path, list(self.columns))

    def array(self, name: str) -> np.ndarray:
        return np.asarray(self.columns[name])
