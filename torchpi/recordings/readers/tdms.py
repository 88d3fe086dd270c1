"""Reader of LabVIEW TDMS: channels as `group/channel`, or by channel name if only one group has it."""

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from torchpi.errors import RecordingError, RecordingWarning
from torchpi.recordings.readers.source import Column, Source, import_extra, reason_of, stated_units


def open_file(path: str) -> "TdmsSource":
    return TdmsSource(path)


@contextmanager
def _as_one_warning(path: str) -> Iterator[None]:
    """Turn messages that npTDMS logs, for example about a truncated recording, into one warning."""
    records: list[logging.LogRecord] = []
    # Each of its modules has its own handler, which prints.
    names = [name for name in logging.root.manager.loggerDict if name.startswith("nptdms.")]
    handlers = {name: logging.getLogger(name).handlers for name in names}
    for name in names:
        logging.getLogger(name).handlers = [_Collector(records)]
    try:
        yield
    finally:
        for name in names:
            logging.getLogger(name).handlers = handlers[name]
    if records:
        more = f", and {len(records) - 1} more" if len(records) > 1 else ""
        text = " ".join(records[0].getMessage().split())[:200]
        warnings.warn(
            f"{path}: {text}{more}; check that the recording is complete", RecordingWarning, stacklevel=2
        )


class _Collector(logging.Handler):
    def __init__(self, records: list[logging.LogRecord]) -> None:
        super().__init__(logging.WARNING)
        self.records = records

    def emit(self, record: logging.LogRecord) -> None:
        self.records.append(record)


class TdmsSource(Source):
    """Channels by group and name."""

    has_times = True

    def __init__(self, path: str) -> None:
        nptdms = import_extra(path, "nptdms")
        try:
            with _as_one_warning(path):
                file = nptdms.TdmsFile.read(path)
        except Exception as error:  # npTDMS lets any parser error through
            raise RecordingError(
                f"{path}: is not a TDMS file ({reason_of(error)}); export it again"
            ) from None
        self.channels = {
            f"{group.name}/{channel.name}": channel for group in file.groups() for channel in group.channels()
        }
        super().__init__(path, list(self.channels))
        self.units = stated_units(
            (name, str(channel.properties.get("unit_string", ""))) for name, channel in self.channels.items()
        )

    def find(self, column: Column, option: str) -> str:
        alone = [name for name in self.names if name.partition("/")[2] == str(column)]
        return alone[0] if len(alone) == 1 else super().find(column, option)

    def read(self, names: list[str]) -> list[np.ndarray]:
        try:
            return [np.asarray(self.channels[name][:], dtype=np.float64) for name in names]
        except (ValueError, TypeError):
            raise RecordingError(
                f"{self.path}: {' or '.join(names)} holds no numbers; choose another"
            ) from None

    def times(self, name: str) -> np.ndarray | None:
        step = self.channels[name].properties.get("wf_increment")
        if not step:
            return None
        # Computed from the increment, because time_track() also needs a start offset.
        return np.arange(len(self.channels[name])) * float(step)
