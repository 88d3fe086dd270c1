"""A stage's file: plain settings with a hash of them, read only if they are what was written."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchpi.errors import ArtifactError
from torchpi.files import content_sha256, load_tensors, save_tensors, write_atomically

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
    content = load_tensors(path, LARGEST_BYTES, f"not a stage file, {EXPECTED}")
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


def save_model(path: str | Path, schema: str, version: int, settings: Mapping[str, Any]) -> None:
    """Write the settings of a stage of its own kind with a hash of them, whole or not at all."""
    content = {"schema": schema, "version": version, **settings}
    with write_atomically(path) as temporary:
        save_tensors({**content, HASH: content_sha256(content)}, temporary)


def load_model(path: str | Path, schema: str, version: int, expected: str) -> dict[str, Any]:
    """The settings in a file that `save_model` wrote.

    Args:
        path: Of the file.
        schema: Its kind.
        version: Of the kind, the one that is read.
        expected: What errors call the kind.

    Raises:
        ArtifactError: No such file, another kind of file, another version, or one that was changed.
    """
    if not Path(path).is_file():
        raise ArtifactError(f"{path}: no such file, expected {expected}")
    content = load_tensors(Path(path), LARGEST_BYTES, f"not a stage file, expected {expected}")
    if schema_of(content) != schema:
        raise ArtifactError(f"{path}: a file of something else, expected {expected}")
    return model_settings(content, path, version)


def model_settings(content: dict[str, Any], path: str | Path, version: int) -> dict[str, Any]:
    """The settings in the content of such a file.

    Raises:
        ArtifactError: Another version, or a content that was changed.
    """
    if content.get("version") != version:
        raise ArtifactError(f"{path}: found version {content.get('version')}, expected {version}")
    if content.pop(HASH, None) != content_sha256(content):
        raise ArtifactError(f"{path}: changed since it was written, expected the file as it was saved")
    return {name: value for name, value in content.items() if name not in ("schema", "version")}


def schema_of(content: object) -> str | None:
    """Which kind of stage the content of a file is, where it is that of one."""
    found = content.get("schema") if isinstance(content, dict) else None
    return found if isinstance(found, str) else None
