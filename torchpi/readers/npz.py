"""NumPy archives: arrays by name, with an index where one has several axes (`u_100mV[:,0,0,0]`)."""

import zipfile

import numpy as np

from torchpi.errors import RecordingError
from torchpi.readers.source import ArraySource


def open_file(path: str) -> "NpzSource":
    return NpzSource(path)


class NpzSource(ArraySource):
    def __init__(self, path: str) -> None:
        if not zipfile.is_zipfile(path):
            raise RecordingError(f"{path}: is not a NumPy archive, wanted one that numpy.savez wrote")
        with np.load(path, allow_pickle=False) as archive:
            super().__init__(path, archive.files)

    def array(self, name: str) -> np.ndarray:
        try:
            with np.load(self.path, allow_pickle=False) as archive:
                return np.asarray(archive[name])
        except (ValueError, OSError, zipfile.BadZipFile) as error:
            raise RecordingError(f"{self.path}: '{name}' cannot be read ({error}); save it again") from None
