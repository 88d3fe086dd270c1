"""The stage in a file, where it is of a kind of its own."""

from pathlib import Path

from torchpi.errors import ArtifactError
from torchpi.files import load_tensors
from torchpi.stage import bouc_wen_oscillator, multi_axis
from torchpi.stage.bouc_wen_oscillator import BoucWenOscillator
from torchpi.stage.file import LARGEST_BYTES, model_settings, schema_of
from torchpi.stage.multi_axis import MultiAxisStage


def load_own_kind(path: str | Path) -> MultiAxisStage | BoucWenOscillator | None:
    """A stage of several axes, or an oscillator; None for any other file, which `Stage.load` may read.

    Raises:
        ArtifactError: Another version, or a file that was changed.
        StageError: A value without meaning.
    """
    try:
        content = load_tensors(Path(path), LARGEST_BYTES, "not a stage file")
    except ArtifactError:
        return None
    match schema_of(content):
        case multi_axis.stage.SCHEMA:
            return MultiAxisStage.of(model_settings(content, path, multi_axis.stage.VERSION), path)
        case bouc_wen_oscillator.SCHEMA:
            return BoucWenOscillator.of(model_settings(content, path, bouc_wen_oscillator.VERSION), path)
    return None
