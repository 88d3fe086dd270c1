"""The stage that belongs to a compensator: identified from the same recordings, and kept beside it."""

from pathlib import Path

from torchpi.stage.stage import Stage

NAME = "stage.pt"
SUFFIX = "_stage.pt"


def exported_stage(output: Path) -> Path:
    """Where the stage of a compensator lies that was exported as `output`, a path without suffix."""
    return output.with_name(output.name + SUFFIX)


def stage_beside(compensator: Path) -> Path | None:
    """The file of the stage that lies beside a compensator's: NAME_stage.pt, or stage.pt; None without."""
    tried = (exported_stage(compensator.with_suffix("")), compensator.with_name(NAME))
    return next((path for path in tried if path.is_file()), None)


def difference(stage: Stage, compensator_sha256: str | None) -> str | None:
    """What a user must know where stage and compensator were made from different recordings; else None.

    Args:
        stage: One that was identified, or one that was written down, which no recordings belong to.
        compensator_sha256: `recordings_sha256` of what the compensator was trained on; None where it is
            not known.
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
