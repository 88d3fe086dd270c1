"""Exported files of a stage with several axes or of its inverse, by format."""

from collections.abc import Sequence
from pathlib import Path

from torchpi.control.multi_axis import MultiAxisInverse
from torchpi.errors import ConfigError
from torchpi.export.formats import Files, written
from torchpi.export.multi_axis.c_source import c_source
from torchpi.export.multi_axis.numbers import numbers
from torchpi.export.multi_axis.tensors import scripted
from torchpi.stage.multi_axis import MultiAxisStage

FORMATS = ("torchscript", "c", "json")


def multi_axis_files(
    exported: MultiAxisStage | MultiAxisInverse, output: Path, formats: Sequence[str]
) -> Files:
    """Return the files of an export by path, for `write_together`.

    Args:
        exported: The stage as a step from voltages to displacements, or its inverse.
        output: Path without suffix.
        formats: One or several of `FORMATS`.

    Raises:
        ConfigError: A format is not one of `FORMATS`.
        ArtifactError: The name cannot be used in C.
    """
    other = [name for name in formats if name not in FORMATS]
    if other or not formats:
        raise ConfigError(
            f"to: found '{','.join(other)}', expected one or more of {','.join(FORMATS)} for several axes"
        )
    files: Files = {}
    if "torchscript" in formats:
        content = scripted(exported).save_to_buffer()
        files[output.with_name(f"{output.name}.pt")] = written(content)
    if "c" in formats:
        for name, text in c_source(exported, output.name).items():
            files[output.with_name(name)] = written(text)
    if "json" in formats:
        files[output.with_name(f"{output.name}.json")] = written(numbers(exported))
    return files
