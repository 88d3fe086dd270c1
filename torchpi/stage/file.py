"""A stage's file: plain settings with a hash of them, read only if they are what was written."""

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from torchpi.errors import ArtifactError
from torchpi.files import check_archive, content_sha256, save_tensors

SCHEMA, VERSION = "torchpi stage", 2
OLDER_SCHEMA = "torchpi augmented stage"
HASH = "sha256"
LARGEST_BYTES = 2**28
EXPECTED = "expected a stage.pt of 'torchpi diagnose' or of a training, or a stage file (.yaml)"


def write_settings(path: Path, settings: Mapping[str, Any]) -> None:
    """Write settings, plain values by name, which `torch.load` reads with weights only."""
    content = {"schema": SCHEMA, "version": VERSION, **settings}
    save_tensors({**content, HASH: content_sha256(content)}, path)


def read_settings(path: Path) -> dict[str, Any]:
    """The settings in a file that `write_settings` wrote.

    Raises:
        ArtifactError: No such file, something else, of another version, or changed since it was written.
    """
    if not path.is_file():
        raise ArtifactError(f"{path}: no such file, {EXPECTED}")
    try:
        with warnings.catch_warnings():
            # torch warns before it refuses a TorchScript file; ours is the error that follows.
            warnings.filterwarnings("ignore", message=".*TorchScript archive.*")
            content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # bytes of anything make the unpickler raise anything
        raise ArtifactError(f"{path}: not a stage file, {EXPECTED}") from error
    check_archive(path, LARGEST_BYTES)
    if not isinstance(content, dict) or content.get("schema") not in (SCHEMA, OLDER_SCHEMA):
        raise ArtifactError(f"{path}: a file of something else, {EXPECTED}")
    if content.get("version") != VERSION:
        raise ArtifactError(
            f"{path}: found version {content.get('version')}, expected {VERSION}: "
            "diagnose the recordings again"
        )
    # Files of earlier versions have no hash; every part of the archive still has its checksum.
    expected = content.pop(HASH, None)
    if expected is not None and expected != content_sha256(content):
        raise ArtifactError(f"{path}: changed since it was written, expected the file as it was saved")
    return {name: value for name, value in content.items() if name not in ("schema", "version")}
