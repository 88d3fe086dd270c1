"""Run an exported compensator in a control loop against a simulated stage: `torchpi run`."""

import math
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console

from torchpi.errors import RecordingWarning
from torchpi.excitation.trajectory import load_trajectory
from torchpi.export import load_torchscript, trained_recordings
from torchpi.files import config_file
from torchpi.loop import run_loop
from torchpi.report import provenance, words, write_loop_report
from torchpi.stage import Stage
from torchpi.stage.beside import difference, stage_beside

DEFAULT_STAGE = Path("default")


def run_files(
    compensator: Path,
    stage: Path | None,
    trajectory: Sequence[str],
    output: Path | None,
    compare: Mapping[str, Path],
    resample: bool,
    max_slew_v_s: float | None,
    seed: int | None,
    command: str,
) -> None:
    """Run along each trajectory, print the remaining error, and write loop.html and loop.json.

    Arguments are those of `torchpi run`; `command` is the command line as typed.

    Raises:
        ArtifactError: A compensator or a stage cannot be used.
        RecordingError: A trajectory cannot be used.
    """
    loaded = load_torchscript(compensator)
    if stage is None:
        stage = stage_beside(compensator) or DEFAULT_STAGE
        own = (
            "the built-in one, because there is none beside the compensator"
            if stage == DEFAULT_STAGE
            else ("identified from your recordings")
        )
        print(f"Stage: {stage}, {own}")
    plant = Stage.load(stage)
    if other := difference(plant, trained_recordings(compensator)):
        warnings.warn(other, RecordingWarning, stacklevel=2)
    others = {name: load_torchscript(path) for name, path in compare.items()}
    trajectories = [
        load_trajectory(
            which,
            fs_hz=plant.sample_rate_hz,
            resample=resample,
            through_reference_filter=loaded.has_reference_filter,
        )
        for which in trajectory
    ]
    results = []
    for one in trajectories:
        print(f"{compensator} on {stage}: {one.title}, {len(one.yd):,} samples")
        with Console(stderr=True).status("") as status:
            result = run_loop(
                loaded,
                plant,
                one.yd,
                fs_hz=plant.sample_rate_hz,
                name=one.name,
                title=one.title,
                yr=one.yr,
                compare=others,
                seed=seed,
                max_slew_v_s=math.inf if max_slew_v_s is None else max_slew_v_s,
                on_drive=status.update,
            )
        results.append(result)
        print(words.table(results[-1]))
        print(words.headline(results[-1]))
        print("\n".join(words.limits(results[-1])) + "\n")
    files: dict[str, str | Path] = {
        "compensator": compensator,
        "stage": config_file(stage, "stage"),
        **compare,
    }
    files |= {
        f"trajectory {one.name}": path
        for one, path in zip(trajectories, trajectory, strict=True)
        if one.sha256
    }
    page, numbers = write_loop_report(
        results, provenance(command, files, seed), output or compensator.with_suffix("")
    )
    print(f"{page}: the page with all figures\n{numbers}: the same numbers")
