"""The stage that belongs to a compensator: identified from the same recordings, and stored beside it."""

from pathlib import Path

from torchpi.stage.stage import Stage

NAME = "stage.pt"
SUFFIX = "_stage.pt"


def exported_stage(output: Path) -> Path:
    """Return the path of the stage of a compensator that was exported as `output`, a path without suffix."""
    return output.with_name(output.name + SUFFIX)


def stage_beside(compensator: Path) -> Path | None:
    """Return the stage's file beside a compensator's: NAME_stage.pt, or stage.pt; None without either."""
    tried = (exported_stage(compensator.with_suffix("")), compensator.with_name(NAME))
    return next((path for path in tried if path.is_file()), None)


def difference(stage: Stage, compensator_sha256: str | None) -> str | None:
    """Return a warning if stage and compensator were made from different recordings; otherwise None.

    Args:
        stage: An identified stage, or one that was specified by hand and has no recordings.
        compensator_sha256: `recordings_sha256` of the recordings that the compensator was trained on; None
            if unknown.
    """
    if stage.identified is None or compensator_sha256 is None:
        return None
    if stage.identified.has(compensator_sha256):
        return None
    return (
        "stage and compensator were made from different recordings "
        f"({stage.identified.recordings_sha256[:8]}… and {compensator_sha256[:8]}…): "
        "the tracking error may be that of another rig"
    )
