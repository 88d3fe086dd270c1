"""Readers of files of measured signals, one module per format; `open_source` chooses by suffix."""

import importlib
import os
from pathlib import Path

from torchpi.errors import RecordingError, kind_of
from torchpi.recordings.readers.source import Source, nearest

__all__ = ["Source", "open_source"]


def open_source(path: str | Path) -> Source:
    """Open a file of signals and list its columns; the numbers are read on demand.

    Raises RecordingError if the file is missing, empty, of an unknown kind, or its reader is not installed.
    """
    if not isinstance(path, str | os.PathLike):
        raise RecordingError(f"path: found {kind_of(path)}, expected the path of a file")
    name, file = str(path), Path(path)
    if file.is_dir():
        raise RecordingError(f"{name}: is a folder, expected a file; give the recording inside it")
    if not file.exists():
        raise RecordingError(f"{name}: no such file{_similar_file(file)}")
    kind = KINDS.get(file.suffix.lower())
    if kind is None:
        known = " ".join(KINDS)
        raise RecordingError(f"{name}: unknown file type '{file.suffix}', expected one of {known}; rename it")
    if file.stat().st_size == 0:
        raise RecordingError(f"{name}: the file is empty; record or export it again")
    try:
        source: Source = importlib.import_module(f"torchpi.recordings.readers.{kind}").open_file(name)
        return source
    except PermissionError as error:
        raise RecordingError(f"{name}: cannot be read ({error.strerror}); change its permissions") from None


KINDS = {
    ".csv": "text", ".txt": "text", ".dat": "text", ".tsv": "text", ".asc": "text",
    ".lvm": "lvm", ".npy": "npy", ".npz": "npz", ".mat": "mat",
    ".h5": "hdf5", ".hdf5": "hdf5", ".tdms": "tdms", ".mf4": "mf4", ".mdf": "mf4",
}  # fmt: skip


def _similar_file(file: Path) -> str:
    folder = file.parent
    if not folder.is_dir():
        return f", and no folder '{folder}'; check the path"
    guess = nearest(file.name, (other.name for other in folder.iterdir()))
    return f"; the nearest name there is '{guess}'" if guess else "; check the path"
