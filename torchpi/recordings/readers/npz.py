"""Reader of NumPy archives: arrays by name, with an index if one has several axes (`u_100mV[:,0,0,0]`)."""

import zipfile

import numpy as np

from torchpi.errors import RecordingError
from torchpi.recordings.readers.source import ArraySource, reason_of


def open_file(path: str) -> "NpzSource":
    return NpzSource(path)


class NpzSource(ArraySource):
    """Arrays by name."""

    def __init__(self, path: str) -> None:
        if not zipfile.is_zipfile(path):
            raise RecordingError(f"{path}: is not a NumPy archive, expected one that numpy.savez wrote")
        try:
            with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
                names = archive.files
        except Exception as error:  # numpy lets any parser error through: BadZipFile, ValueError, KeyError …
            raise RecordingError(
                f"{path}: is not a NumPy archive ({reason_of(error)}); save it again"
            ) from None
        super().__init__(path, names)

    def array(self, name: str) -> np.ndarray:
        try:
            with open(self.path, "rb") as file, np.load(file, allow_pickle=False) as archive:
                return np.asarray(archive[name])
        except Exception as error:  # as above, and zlib.error, NotImplementedError, MemoryError …
            raise RecordingError(
                f"{self.path}: '{name}' cannot be read ({reason_of(error)}); save it again"
            ) from None
