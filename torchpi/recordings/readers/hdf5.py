"""Reader of HDF5: datasets by path (`group/u`); also MATLAB 7.3 files, whose axes are in reverse order."""

from typing import Any

import numpy as np

from torchpi.errors import RecordingError
from torchpi.recordings.readers.source import ArraySource, import_extra, reason_of, stated_units


def open_file(path: str) -> "Hdf5Source":
    return Hdf5Source(path, matlab=False)


class Hdf5Source(ArraySource):
    """Datasets by path."""

    def __init__(self, path: str, matlab: bool) -> None:
        h5py = self.h5py = import_extra(path, "h5py")
        self.matlab = matlab
        self.paths: dict[str, str] = {}
        attributes: dict[str, str] = {}

        def note(name: str, item: Any) -> None:
            # MATLAB keeps its bookkeeping under #refs# and #subsystem#.
            if isinstance(item, h5py.Dataset) and item.dtype.kind in "fiub" and not name.startswith("#"):
                shown = name.replace("/", ".") if matlab else name
                self.paths[shown] = name
                attributes[shown] = str(item.attrs.get("units", item.attrs.get("unit", "")))

        try:
            with h5py.File(path, "r") as file:
                file.visititems(note)
        except Exception as error:  # h5py lets any parser error through: OSError, RuntimeError, KeyError …
            raise RecordingError(
                f"{path}: is not an HDF5 file ({reason_of(error)}); export it again"
            ) from None
        super().__init__(path, list(self.paths))
        self.units = stated_units(attributes.items())

    def array(self, name: str) -> np.ndarray:
        try:
            with self.h5py.File(self.path, "r") as file:
                stored = np.asarray(file[self.paths[name]])
        except (OSError, RuntimeError, KeyError, MemoryError) as error:
            raise RecordingError(
                f"{self.path}: '{name}' cannot be read ({reason_of(error)}); export it again"
            ) from None
        return stored.T if self.matlab else stored

    def find(self, column: str | int, option: str) -> str:
        name = str(column).strip("/") or str(column)
        return super().find(name.replace("/", ".") if self.matlab else name, option)
