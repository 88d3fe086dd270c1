"""Reader of MATLAB files: variables by name, struct fields as `struct.field`. Version 7.3 is HDF5 inside."""

from typing import Any

import numpy as np

from torchpi.errors import RecordingError
from torchpi.recordings.readers.source import ArraySource, reason_of


def open_file(path: str) -> ArraySource:
    with open(path, "rb") as file:
        head = file.read(520)
    if head.startswith(b"MATLAB 7.3") or b"\x89HDF\r\n\x1a\n" in (head[:8], head[512:520]):
        from torchpi.recordings.readers.hdf5 import Hdf5Source

        return Hdf5Source(path, matlab=True)
    return MatSource(path)


class MatSource(ArraySource):
    """Variables by name."""

    def __init__(self, path: str) -> None:
        from scipy.io import loadmat

        try:
            stored = loadmat(path, simplify_cells=True)
        except Exception as error:  # scipy lets any parser error through: ValueError, TypeError, zlib.error …
            raise RecordingError(
                f"{path}: is not a MATLAB file ({reason_of(error)}); save it again with -v7"
            ) from None
        self.variables = dict(_flat({name: stored[name] for name in stored if not name.startswith("__")}))
        super().__init__(path, list(self.variables))

    def array(self, name: str) -> Any:
        return self.variables[name]


def _flat(struct: dict[str, Any], prefix: str = "") -> Any:
    for name, value in struct.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", np.asarray(value)
