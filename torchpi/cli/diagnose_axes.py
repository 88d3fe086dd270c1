"""A diagnosis of several axes that reads recording files and writes result files."""

import json
import time
from collections.abc import Sequence
from pathlib import Path

import torch

from torchpi.cli.workers import available_cores
from torchpi.errors import SimulationError
from torchpi.files import check_output_folder, write_text
from torchpi.identification.multi_axis import MultiAxisOptions
from torchpi.identification.multi_axis.diagnosis import AxesDiagnosis, diagnose_axes
from torchpi.recordings.multi_axis import read_multi_axis
from torchpi.recordings.options import RecordingOptions
from torchpi.stage.kinds import load_axes


def diagnose_axes_files(
    paths: Sequence[Path],
    output: Path,
    simulation: str | None,
    seconds: float,
    command: str,
    options: RecordingOptions,
) -> AxesDiagnosis:
    """Read, diagnose, and write report.html, diagnosis.json and stage.pt.

    Raises:
        ArtifactError: The output cannot be written to.
        RecordingError: A recording cannot be used; the message states why.
        SimulationError: The simulation is not a stage of several axes.
    """
    from torchpi.report.axes_page import write_axes_diagnosis
    from torchpi.report.what_was_run import provenance

    check_output_folder(output)
    given = None if simulation is None else load_axes(simulation)
    if simulation is not None and given is None:
        raise SimulationError(
            f"{simulation}: found no stage of several axes, expected the stage.pt of a multi-axis training "
            "or diagnosis, or no simulation"
        )
    recordings = [read_multi_axis(path, options, None) for path in paths]
    started = time.monotonic()

    def log(sentence: str) -> None:
        print(f"{time.monotonic() - started:6.1f} s  {sentence}", flush=True)

    for path, one in zip(paths, recordings, strict=True):
        held = f"{one.periods} periods" if one.periods > 1 else "no periods"
        log(f"{path}: {len(one.u):,} samples at {one.fs_hz:g} Hz, {held}, {one.u.std():.3g} V rms")
    modes = MultiAxisOptions.modes if given is None else given.shapes.modes
    torch.set_num_threads(available_cores())  # for the fits; linear algebra stays at one thread
    found = diagnose_axes(recordings, given, MultiAxisOptions(modes=modes, seconds=seconds), log)
    files = {f"recording {one.name}": str(path) for path, one in zip(paths, recordings, strict=True)}
    if simulation is not None:
        files["simulation"] = simulation
    page = write_axes_diagnosis(found, provenance(command, files), output / "report.html")
    text = json.dumps(found.as_json(), indent=1, ensure_ascii=False)
    write_text(output / "diagnosis.json", text + "\n")
    found.stage.save(output / "stage.pt")
    print(f"\n{found.summary}\n")
    for what, file in (
        ("the page", page),
        ("the same results as numbers", output / "diagnosis.json"),
        ("the augmented stage", output / "stage.pt"),
    ):
        print(f"{file}: {what}")
    return found
