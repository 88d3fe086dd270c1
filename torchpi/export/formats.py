"""The formats of an export, whose files are written all together or not at all."""

from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path

from torchpi.errors import ConfigError
from torchpi.export.deployable import Deployable
from torchpi.export.safety_card import Load
from torchpi.files import as_path, to_disk, write_atomically
from torchpi.operators.reference_filter import ReferenceFilter

Files = dict[Path, Callable[[Path], object]]  # path of each file, and the function that writes its content
SUFFIXES = (".pt", ".c", ".h", ".fmu", ".pt2", ".json", ".html")
MODULES = {
    "torchscript": "torchscript",
    "c": "c_source",
    "fmu": "fmu",
    "pt2": "pt2",
    "json": "numbers",
    "page": "page",
}
"""Module that makes each format."""
FORMATS = tuple(MODULES)


def export_files(
    compensator: Deployable,
    output: str | Path,
    formats: str | Sequence[str] = ("torchscript", "json"),
    reference_filter: ReferenceFilter | None = None,
    load: Load | None = None,
) -> list[Path]:
    """Write `output` with the suffixes of the formats and return the paths of the files.

    All files are made before the first is put in place. Arguments and errors are those of `made_files`.

    Example:
        >>> from torchpi import DirectInverse
        >>> from torchpi.export import export_files
        >>> compensator = DirectInverse(1e-4, thresholds=[0.0, 0.1, 0.3])
        >>> [file.name for file in export_files(compensator, "mine", ["c", "json"])]
        ['mine.h', 'mine.c', 'mine_selftest.c', 'mine.json']
    """
    files = made_files(compensator, output, formats, reference_filter, load)
    write_together(files)
    return list(files)


def made_files(
    compensator: Deployable,
    output: str | Path,
    formats: str | Sequence[str] = ("torchscript", "json"),
    reference_filter: ReferenceFilter | None = None,
    load: Load | None = None,
) -> Files:
    """Return the files of an export by path, for `write_together`.

    Args:
        compensator: The compensator to export.
        output: Path without suffix.
        formats: One or several of `FORMATS`.
        reference_filter: Filter placed before the compensator, inside the files.
        load: What the amplifier drives, for the safety card in the formats json and page.

    Raises:
        ConfigError: A format is unknown.
        ArtifactError: The compensator has a part that one of the formats cannot represent or a number that
            is not finite, or the name cannot be used in C. Nothing is written then.
    """
    formats = [formats] if isinstance(formats, str) or not isinstance(formats, Iterable) else list(formats)
    unknown = [str(name) for name in formats if name not in FORMATS]
    if unknown or not formats:
        raise ConfigError(f"to: found '{','.join(unknown)}', expected one or more of {','.join(FORMATS)}")
    files: Files = {}
    for name in formats:
        files |= _made(name, compensator, Path(output), reference_filter, load)
    return files


def without_suffix(output: str | Path) -> Path:
    """Remove the suffix of an exported file (`mine` for `mine.pt`); other dots stay."""
    path = as_path(output)
    return path.with_suffix("") if path.suffix in SUFFIXES else path


def written(content: str | bytes) -> Callable[[Path], object]:
    """Return a function that writes this content to a path, with the same line endings on every system."""
    encoded = content.encode() if isinstance(content, str) else content
    return lambda path: path.write_bytes(encoded)


def write_together(files: Files) -> None:
    """Write every file to a temporary path beside its own; when all are written, put them in place.

    Args:
        files: Functions that write the files, by path, from `made_files`.
    """
    with ExitStack() as placed:
        for path, write in files.items():
            temporary = placed.enter_context(write_atomically(path))
            write(temporary)
            to_disk(temporary)


def _made(
    name: str,
    compensator: Deployable,
    output: Path,
    reference_filter: ReferenceFilter | None,
    load: Load | None,
) -> Files:
    # Imported only when needed, because torch.export is slow to import.
    module = import_module(f"torchpi.export.{MODULES[name]}")
    card = (load,) if name in ("json", "page") else ()
    files: Files = getattr(module, f"{name}_files")(compensator, output, reference_filter, *card)
    return files
