"""Load stages that have a kind of file of their own: several axes, Bouc–Wen oscillator."""

from pathlib import Path

from torchpi.errors import ArtifactError
from torchpi.files import load_tensors
from torchpi.stage.bouc_wen_oscillator import BoucWenOscillator
from torchpi.stage.file import LARGEST_BYTES, schema_of
from torchpi.stage.multi_axis import MultiAxisStage


def load_axes(path: str | Path) -> MultiAxisStage | None:
    """Return the stage of several axes in a file; None for any other or a missing file.

    Raises:
        ArtifactError, StageError: As for `load_own_kind`.
    """
    found = load_own_kind(path) if Path(path).is_file() else None
    return found if isinstance(found, MultiAxisStage) else None


def load_own_kind(path: str | Path) -> MultiAxisStage | BoucWenOscillator | None:
    """Return a stage of several axes or an oscillator; None for any other file, which `Stage.load` may read.

    Raises:
        ArtifactError: Another version, or a file that was changed.
        StageError: An invalid value.
    """
    try:
        schema = schema_of(load_tensors(Path(path), LARGEST_BYTES, "not a stage file"))
    except ArtifactError:
        return None
    kinds = {kind.SCHEMA: kind for kind in (MultiAxisStage, BoucWenOscillator)}
    return kinds[schema].load(path) if schema in kinds else None
