"""Reader of MF4 (ASAM MDF): channels by name, each with the time stamps of its group."""

import gc
import sys
from typing import Any

import numpy as np

from torchpi.errors import RecordingError
from torchpi.recordings.readers.source import Source, import_extra, reason_of, stated_units


def open_file(path: str) -> "Mf4Source":
    return Mf4Source(path)


class Mf4Source(Source):
    """Channels by name."""

    has_times = True

    def __init__(self, path: str) -> None:
        asammdf = import_extra(path, "asammdf")
        problem = None
        # If a file cannot be read, the half-constructed object raises once more when it is deleted.
        before, sys.unraisablehook = sys.unraisablehook, lambda _: None
        try:
            self.file = asammdf.MDF(path)
        except Exception as error:  # asammdf lets any parser error through
            problem = reason_of(error)
        finally:
            if problem is not None:
                gc.collect()  # it is part of a reference cycle
            sys.unraisablehook = before
        if problem is not None:
            raise RecordingError(f"{path}: is not an MDF file ({problem}); export it again")
        super().__init__(path, list(self.file.channels_db))

    def unit(self, name: str) -> str | None:
        return stated_units([(name, str(self._signal(name).unit))]).get(name) or super().unit(name)

    def read(self, names: list[str]) -> list[np.ndarray]:
        try:
            return [np.asarray(self._signal(name).samples, dtype=np.float64) for name in names]
        except (ValueError, TypeError):
            raise RecordingError(
                f"{self.path}: {' or '.join(names)} holds no numbers; choose another"
            ) from None
        except Exception as error:  # from a damaged block
            raise RecordingError(
                f"{self.path}: cannot be read ({reason_of(error)}); export it again"
            ) from None

    def times(self, name: str) -> np.ndarray | None:
        return np.asarray(self._signal(name).timestamps, dtype=np.float64)

    def _signal(self, name: str) -> Any:
        group, index = self.file.channels_db[name][0]
        return self.file.get(group=group, index=index)
