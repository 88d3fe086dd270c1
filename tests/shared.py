"""Folders that the test processes share: the first that needs one makes it."""

import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from filelock import FileLock

FOLDER = "TORCHPI_TESTS_SHARE"
"""Environment variable: where these folders are, for the duration of one run of the tests."""


def begin() -> None:
    os.environ[FOLDER] = tempfile.mkdtemp(prefix="torchpi-tests-")


def end() -> None:
    shutil.rmtree(os.environ.pop(FOLDER), ignore_errors=True)


def made_once(name: str, make: Callable[[Path], None]) -> Path:
    """Return the folder of this name, which `make` has filled."""
    folder = Path(os.environ[FOLDER]) / name
    with FileLock(f"{folder}.lock"):
        if not folder.exists():
            begun = folder.with_suffix(".begun")
            shutil.rmtree(begun, ignore_errors=True)
            begun.mkdir()
            make(begun)
            begun.rename(folder)
    return folder
