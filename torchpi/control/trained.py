"""Loading a trained compensator from its run folder or checkpoint."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchpi.control.direct_inverse import DirectInverse
from torchpi.errors import ArtifactError, ConfigError
from torchpi.files import content_sha256, load_tensors

HYPER_PARAMETERS = "compensator_hyper_parameters"
STATE = "compensator_state"
HASH = "compensator_sha256"
LARGEST_BYTES = 2**30


def to_checkpoint(compensator: DirectInverse) -> dict[str, Any]:
    """Return a compensator as a checkpoint stores it: plain hyper-parameters, tensors, and a hash of both."""
    kept = {HYPER_PARAMETERS: compensator.hyper_parameters, STATE: compensator.state_dict()}
    return {**kept, HASH: content_sha256(kept)}


def load_compensator(path: str | Path) -> DirectInverse:
    """Load the compensator of a run folder's best checkpoint, or of a checkpoint file.

    Args:
        path: The folder or the file.

    Raises:
        ArtifactError: No file, a file of another kind, or one that changed since it was written.
    """
    path = Path(path)
    file = path / "checkpoints" / "best.ckpt" if path.is_dir() else path
    if not file.is_file():
        raise ArtifactError(f"{file}: no such file, expected a run folder of 'torchpi train fit'")
    wrong = "not a checkpoint, expected a run folder of 'torchpi train fit'"
    checkpoint = load_tensors(file, LARGEST_BYTES, wrong)
    if not isinstance(checkpoint, dict) or HYPER_PARAMETERS not in checkpoint:
        raise ArtifactError(f"{file}: a checkpoint of another kind, expected one of 'torchpi train fit'")
    kept: dict[str, Any] = {name: checkpoint.get(name) for name in (HYPER_PARAMETERS, STATE)}
    if not all(isinstance(part, Mapping) for part in kept.values()):
        raise ArtifactError(f"{file}: found no parameters of a compensator, expected a whole checkpoint")
    # Checkpoints of earlier versions have no hash; every part of the archive still has its checksum.
    if HASH in checkpoint and checkpoint[HASH] != content_sha256(kept):
        raise ArtifactError(f"{file}: changed since it was written, expected the checkpoint as trained")
    try:
        compensator = DirectInverse(**kept[HYPER_PARAMETERS])
        compensator.load_state_dict(kept[STATE])
    except ConfigError as error:
        raise ArtifactError(f"{file}: {error}") from error
    except (TypeError, ValueError, RuntimeError, AttributeError, OverflowError, MemoryError) as error:
        first = str(error).partition("\n")[0]
        raise ArtifactError(f"{file}: the parameters are not those of a compensator ({first})") from error
    return compensator


def with_slew_limit(compensator: DirectInverse, max_slew_v_s: float) -> DirectInverse:
    """Return the same compensator with its deployed step limited to this rate of the voltage.

    Raises:
        ConfigError: A rate that is not positive.
    """
    limited = DirectInverse(**{**compensator.hyper_parameters, "max_slew_v_s": max_slew_v_s})
    limited.load_state_dict(compensator.state_dict())
    return limited
