"""The compensator as a TorchScript file: `reset`, `step`, `block`, and its attributes.

TorchScript is deprecated in torch 2.13, and works; it is the contract here because the file loads in
Python and in C++ without torchpi.
"""

import warnings
import zipfile
from pathlib import Path
from typing import cast

import torch
from torch import nn

from torchpi.compensator_stream import CompensatorStream
from torchpi.errors import ArtifactError
from torchpi.export.deployable import Deployable
from torchpi.export.formats import Files
from torchpi.files import write_atomically
from torchpi.operators.reference_filter import ReferenceFilter

_KEPT = (
    "reset",
    "step",
    "block",
    "sample_period_s",
    "preview",
    "min_voltage_v",
    "max_voltage_v",
    "held_inputs",
    "has_reference_filter",
)


def torchscript_files(
    compensator: Deployable, output: Path, reference_filter: ReferenceFilter | None = None
) -> Files:
    """NAME.pt, the frozen step of `compensator`; a reference filter goes inside on request."""
    scripted = script(compensator, reference_filter)
    return {output.with_name(output.name + ".pt"): lambda path: scripted.save(str(path))}


def save_torchscript(
    compensator: Deployable,
    path: str | Path,
    reference_filter: ReferenceFilter | None = None,
) -> None:
    """Write the file to `path`."""
    (write,) = torchscript_files(compensator, Path(path), reference_filter).values()
    with write_atomically(path) as temporary:
        write(temporary)


def script(
    compensator: Deployable, reference_filter: ReferenceFilter | None = None
) -> torch.jit.ScriptModule:
    """The compensator's stream, compiled and frozen: constants inside, state kept."""
    stream = cast(nn.Module, compensator.stream(reference_filter)).eval()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*torch.jit.*deprecated.*")
        frozen = torch.jit.freeze(torch.jit.script(stream), preserved_attrs=list(_KEPT))
    return cast(torch.jit.ScriptModule, frozen)


def load_torchscript(path: str | Path) -> CompensatorStream:
    """Load an exported compensator, warm and reset.

    Raises:
        ArtifactError: There is no such file, or it is not a compensator.
    """
    path = Path(path)
    if not path.is_file():
        raise ArtifactError(f"{path}: no such file, want a compensator written by 'torchpi export'")
    if not zipfile.is_zipfile(path):
        raise ArtifactError(f"{path}: not a TorchScript file, want a compensator written by 'torchpi export'")
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*torch.jit.*deprecated.*")
            loaded = torch.jit.load(str(path), map_location="cpu")
    except RuntimeError as error:
        raise ArtifactError(
            f"{path}: not a TorchScript file, want a compensator written by 'torchpi export'"
        ) from error
    missing = [name for name in _KEPT if not hasattr(loaded, name)]
    if missing:
        raise ArtifactError(
            f"{path}: a TorchScript file without {', '.join(missing)}, "
            "want a compensator written by 'torchpi export'"
        )
    warm(loaded)
    return cast(CompensatorStream, loaded)


def warm(loaded: CompensatorStream) -> None:
    """Run the first calls, which compile and cost milliseconds, and return to the de-energised state."""
    for _ in range(20):
        loaded.step(0.0)
    loaded.reset()
