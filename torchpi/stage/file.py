"""A stage's file: plain settings with their hash, accepted only if unchanged since they were written."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Self

from torch import nn

from torchpi.errors import ArtifactError, StageError
from torchpi.files import content_sha256, load_tensors, save_tensors, write_atomically

SCHEMA, VERSION = "torchpi stage", 3
OLDER_SCHEMA = "torchpi augmented stage"
HASH = "sha256"
LARGEST_BYTES = 2**28
EXPECTED = "expected a stage.pt of 'torchpi diagnose' or of a training, or a stage file (.yaml)"


def write_settings(
    path: Path, settings: Mapping[str, Any], schema: str = SCHEMA, version: int = VERSION
) -> None:
    """Write settings, plain values by name, which `torch.load` reads with weights only."""
    content = {"schema": schema, "version": version, **settings}
    save_tensors({**content, HASH: content_sha256(content)}, path)


def read_settings(
    path: Path,
    schemas: Sequence[str] = (SCHEMA, OLDER_SCHEMA),
    version: int = VERSION,
    expected: str = EXPECTED,
) -> dict[str, Any]:
    """Return the settings in a file that `write_settings` wrote.

    Args:
        path: Path of the file.
        schemas: The kinds of files that are accepted.
        version: The version that is accepted.
        expected: The end of error messages about another kind of file.

    Raises:
        ArtifactError: The file is missing, of another kind or version, or changed since it was written.
    """
    if not path.is_file():
        raise ArtifactError(f"{path}: no such file, {expected}")
    content = load_tensors(path, LARGEST_BYTES, f"not a stage file, {expected}")
    if schema_of(content) not in schemas:
        raise ArtifactError(f"{path}: a file of another kind, {expected}")
    if content.get("version") != version:
        raise ArtifactError(
            f"{path}: found version {content.get('version')}, expected {version}: identify the stage again"
        )
    # Files of earlier versions have no hash; every part of the archive still has its checksum.
    written = content.pop(HASH, None)
    if written is not None and written != content_sha256(content):
        raise ArtifactError(f"{path}: changed since it was written, expected the file as it was saved")
    return {name: value for name, value in content.items() if name not in ("schema", "version")}


def schema_of(content: object) -> str | None:
    """Return the kind of stage that the content of a file names, if any."""
    found = content.get("schema") if isinstance(content, dict) else None
    return found if isinstance(found, str) else None


class SavedStage(nn.Module):
    """A stage of a kind of its own, whose file holds the arguments that it is made of.

    Attributes:
        SCHEMA: Name of the kind in its files.
        VERSION: Version of the kind that is written and read.
        KIND: Name of the kind in error messages.
    """

    SCHEMA: ClassVar[str]
    VERSION: ClassVar[int]
    KIND: ClassVar[str]

    def plain(self) -> dict[str, Any]:
        """Return settings and parameters as the file stores them: the arguments of the class."""
        raise NotImplementedError

    def save(self, path: str | Path) -> None:
        """Write the stage atomically, as plain numbers with their hash."""
        with write_atomically(path) as temporary:
            write_settings(temporary, self.plain(), self.SCHEMA, self.VERSION)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Return the stage in a file that `save` wrote.

        Raises:
            ArtifactError: The file is missing, of another kind or version, or was changed.
            StageError: An invalid value.
        """
        settings = read_settings(Path(path), [cls.SCHEMA], cls.VERSION, f"expected {cls.KIND}")
        try:
            return cls(**settings)
        except StageError:
            raise
        except (TypeError, ValueError) as error:
            raise ArtifactError(f"{path}: fields of another kind, expected those of {cls.KIND}") from error
