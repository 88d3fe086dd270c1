"""A trained compensator, from its run folder or checkpoint."""

import warnings
from pathlib import Path
from typing import Any

import torch

from torchpi.compensator import DirectInverse
from torchpi.errors import ArtifactError

HYPER_PARAMETERS = "compensator_hyper_parameters"
STATE = "compensator_state"


def to_checkpoint(compensator: DirectInverse) -> dict[str, Any]:
    """What a checkpoint keeps of a compensator: plain hyper-parameters and tensors."""
    return {HYPER_PARAMETERS: compensator.hyper_parameters, STATE: compensator.state_dict()}


def load_compensator(path: str | Path) -> DirectInverse:
    """The compensator of a run folder's best checkpoint, or of a checkpoint file.

    Raises:
        ArtifactError: Nothing there, or something else.
    """
    path = Path(path)
    file = path / "checkpoints" / "best.ckpt" if path.is_dir() else path
    if not file.is_file():
        raise ArtifactError(f"{file}: no such file, want a run folder of 'python -m train fit'")
    try:
        with warnings.catch_warnings():
            # torch warns before it refuses a TorchScript file; ours is the error that follows.
            warnings.filterwarnings("ignore", message=".*TorchScript archive.*")
            checkpoint = torch.load(file, map_location="cpu", weights_only=True)
    except Exception as error:  # bytes of anything make the unpickler raise anything
        raise ArtifactError(
            f"{file}: not a checkpoint, want a run folder of 'python -m train fit'"
        ) from error
    if not isinstance(checkpoint, dict) or HYPER_PARAMETERS not in checkpoint:
        raise ArtifactError(f"{file}: a checkpoint of something else, want one of 'python -m train fit'")
    compensator = DirectInverse(**checkpoint[HYPER_PARAMETERS])
    compensator.load_state_dict(checkpoint[STATE])
    return compensator
