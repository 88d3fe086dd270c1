"""The compensator as a TorchScript file: `reset`, `step`, `block`, and its attributes.

TorchScript is deprecated in torch 2.13 but still works. It is used here because the file loads in Python and
in C++ without torchpi.
"""

import math
import warnings
import zipfile
from pathlib import Path
from typing import Any, cast

import torch
from torch import nn

from torchpi.control.step import CompensatorStream
from torchpi.errors import ArtifactError
from torchpi.export.deployable import Deployable
from torchpi.export.formats import Files, written
from torchpi.export.torchscript_check import METHODS, RECORDINGS_PART, check_file, check_graph
from torchpi.export.written_out import written_out
from torchpi.operators.reference_filter import ReferenceFilter

MOST_PREVIEW = 1_000_000  # samples
_ATTRIBUTES: dict[str, type] = {
    "sample_period_s": float,
    "preview": int,
    "min_voltage_v": float,
    "max_voltage_v": float,
    "has_reference_filter": bool,
    "held_inputs": int,
    "outside_range": int,
    "limited_outputs": int,
}


def torchscript_files(
    compensator: Deployable, output: Path, reference_filter: ReferenceFilter | None = None
) -> Files:
    """Return NAME.pt, the frozen step of `compensator`, with the reference filter inside if one is given."""
    scripted = script(compensator, reference_filter)
    known = getattr(compensator, "recordings_sha256", None)
    extra = {} if known is None else {RECORDINGS_PART.removeprefix("extra/"): known}
    # Saved to a buffer, because saving to a path stores its name in the file, and the path is temporary.
    content = scripted.save_to_buffer(_extra_files=extra)
    return {output.with_name(output.name + ".pt"): written(content)}


def script(
    compensator: Deployable, reference_filter: ReferenceFilter | None = None
) -> torch.jit.ScriptModule:
    """Compile and freeze the stream of the compensator: constants are inlined, state is kept."""
    stream = written_out(cast(nn.Module, compensator.stream(reference_filter))).eval()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*torch.jit.*deprecated.*")
        frozen = torch.jit.freeze(torch.jit.script(stream), preserved_attrs=[*METHODS, *_ATTRIBUTES])
    return cast(torch.jit.ScriptModule, frozen)


def load_torchscript(path: str | Path) -> CompensatorStream:
    """Load an exported compensator, warmed up and reset; only code that torchpi itself writes is run.

    Args:
        path: A `.pt` file of `export_files` or `torchpi export`.

    Raises:
        ArtifactError: The file does not exist, is not a compensator, is damaged, or holds an operator or a
            number that no compensator has.

    Example:
        >>> from torchpi import DirectInverse
        >>> from torchpi.export import export_files, load_torchscript
        >>> compensator = DirectInverse(1e-4, thresholds=[0.0, 0.1], preview=2)
        >>> files = export_files(compensator, "mine", "torchscript")
        >>> deployed = load_torchscript("mine.pt")
        >>> deployed.step(0.5) == compensator.stream().step(0.5)
        True
    """
    path = Path(path)
    if not path.is_file():
        raise ArtifactError(f"{path}: no such file, expected a compensator written by 'torchpi export'")
    if not zipfile.is_zipfile(path):
        raise ArtifactError(
            f"{path}: not a TorchScript file, expected a compensator written by 'torchpi export'"
        )
    check_file(path)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*torch.jit.*deprecated.*")
            loaded = torch.jit.load(str(path), map_location="cpu")
    except (RuntimeError, ValueError) as error:
        raise ArtifactError(
            f"{path}: not a TorchScript file, expected a compensator written by 'torchpi export'"
        ) from error
    check_graph(path, loaded)
    _check_attributes(path, loaded)
    try:
        warm(loaded)
    except RuntimeError as error:
        raise ArtifactError(f"{path}: its step fails; expected a compensator of 'torchpi export'") from error
    return cast(CompensatorStream, loaded)


def trained_recordings(path: str | Path) -> str | None:
    """Return `recordings_sha256` of the training data of an exported compensator, or None if unknown.

    Args:
        path: A file that `load_torchscript` has accepted.
    """
    with zipfile.ZipFile(path) as archive:
        parts = [name for name in archive.namelist() if name.endswith("/" + RECORDINGS_PART)]
        return archive.read(parts[0]).decode("ascii") if parts else None


def _check_attributes(path: Path, loaded: torch.jit.ScriptModule) -> None:
    for name, kind in _ATTRIBUTES.items():
        value: Any = getattr(loaded, name, None)
        finite = isinstance(value, int | float) and math.isfinite(value)
        if type(value) is not kind or not finite:
            raise ArtifactError(f"{path}: {name}: found {value}, expected a finite {kind.__name__}")
    if loaded.sample_period_s <= 0:
        raise ArtifactError(
            f"{path}: sample_period_s: found {loaded.sample_period_s}, expected a positive number of s"
        )
    if not 0 <= loaded.preview <= MOST_PREVIEW:
        raise ArtifactError(f"{path}: preview: found {loaded.preview}, expected 0 to {MOST_PREVIEW} samples")
    if not loaded.min_voltage_v < loaded.max_voltage_v:
        raise ArtifactError(
            f"{path}: min_voltage_v: found {loaded.min_voltage_v} V, expected less than max_voltage_v, "
            f"{loaded.max_voltage_v} V"
        )


def warm(loaded: CompensatorStream) -> None:
    """Run the first calls, which take milliseconds for compilation, then reset to the de-energised state."""
    for _ in range(20):
        loaded.step(0.0)
    loaded.reset()
