"""MF4 (ASAM MDF): channels by name, each with the time stamps of its group."""

from typing import Any

import numpy as np

from torchpi.errors import RecordingError
from torchpi.readers.source import Source, import_extra, stated_units


def open_file(path: str) -> "Mf4Source":
    return Mf4Source(path)


class Mf4Source(Source):
    has_times = True

    def __init__(self, path: str) -> None:
        asammdf = import_extra(path, "asammdf")
        try:
            self.file = asammdf.MDF(path)
        except Exception as error:  # asammdf raises whatever its parser met
            raise RecordingError(f"{path}: is not an MDF file ({error}); export it again") from None
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

    def times(self, name: str) -> np.ndarray | None:
        return np.asarray(self._signal(name).timestamps, dtype=np.float64)

    def _signal(self, name: str) -> Any:
        group, index = self.file.channels_db[name][0]
        return self.file.get(group=group, index=index)
