"""NumPy archives: arrays by name, with an index where one has several axes (`u_100mV[:,0,0,0]`)."""

import zipfile
import zlib

import numpy as np

from torchpi.errors import RecordingError
from torchpi.readers.source import ArraySource


def open_file(path: str) -> "NpzSource":
    return NpzSource(path)


class NpzSource(ArraySource):
    def __init__(self, path: str) -> None:
        if not zipfile.is_zipfile(path):
            raise RecordingError(f"{path}: is not a NumPy archive, expected one that numpy.savez wrote")
        try:
            with np.load(path, allow_pickle=False) as archive:
                names = archive.files
        except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
            raise RecordingError(f"{path}: is not a NumPy archive ({error}); save it again") from None
        super().__init__(path, names)

    def array(self, name: str) -> np.ndarray:
        try:
            with np.load(self.path, allow_pickle=False) as archive:
                return np.asarray(archive[name])
        except (ValueError, OSError, EOFError, SyntaxError, MemoryError, KeyError, zlib.error,
                zipfile.BadZipFile, NotImplementedError) as error:  # fmt: skip
            raise RecordingError(f"{self.path}: '{name}' cannot be read ({error}); save it again") from None
