"""A diagnosis that reads recording files and writes result files."""

import shutil
import time
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

from torchpi.cli.duration import Countdown
from torchpi.cli.workers import worker_pool
from torchpi.diagnosis.diagnose import diagnose
from torchpi.diagnosis.diagnosis import Diagnosis
from torchpi.diagnosis.parallel import get_ready
from torchpi.diagnosis.simulation import Simulation
from torchpi.errors import ConfigError
from torchpi.files import check_output_folder, config_file, is_own_config
from torchpi.recordings.recording import RecordingOptions, read_recording
from torchpi.simulators import COLUMN, Simulator, load_simulator
from torchpi.stage import Stage


def diagnose_files(
    paths: Sequence[Path],
    output: Path,
    simulation: str | None,
    executor: str,
    command: str,
    options: RecordingOptions,
) -> Diagnosis:
    """Read, diagnose, and write the report, the JSON, the stage, the next excitation and the figures.

    Arguments are those of `torchpi diagnose`; `command` is the command line as typed, and `options` states
    how the files are read. Nothing is written before all results are known.

    Raises:
        ConfigError: The executor is unknown.
        ArtifactError: The output cannot be written to.
        RecordingError: A recording cannot be used; the message states why.
    """
    # Imported here, because drawing needs matplotlib and a diagnosis from Python does not.
    from torchpi.report.diagnosis_events import write_tensorboard
    from torchpi.report.diagnosis_page import write_diagnosis
    from torchpi.report.what_was_run import provenance

    if executor not in ("processes", "here"):
        raise ConfigError(f"--executor: found '{executor}', expected processes or here")
    check_output_folder(output)
    given = None if simulation is None else load_simulation(simulation)
    recordings = [
        read_recording(path, options, allow_constant_input=True, simulated=given == COLUMN) for path in paths
    ]
    started, countdown = time.monotonic(), Countdown()

    def log(sentence: str) -> None:
        elapsed_s = time.monotonic() - started
        print(f"{elapsed_s:6.1f} s  {sentence}{countdown.left(sentence, elapsed_s)}", flush=True)

    for recording in recordings:
        log(f"{recording.source}: {len(recording):,} samples at {recording.fs_hz:g} Hz")
    with worker_pool(get_ready) if executor == "processes" else nullcontext() as pool:
        found = diagnose(recordings, given, log=log, executor=pool)
    log("report: figures and page")
    files = {f"recording {recording.name}": recording.source for recording in recordings}
    if isinstance(given, Simulator) and given.source:
        files[f"simulation {given.reference}"] = given.source
    elif isinstance(given, Stage):
        files["simulation"] = str(config_file(str(simulation), "stage"))
    page, numbers = write_diagnosis(found, provenance(command, files), output)
    found.stage.save(output / "stage.pt")
    shutil.rmtree(output / "tensorboard", ignore_errors=True)
    write_tensorboard(found, output)
    log("done")
    print(f"\n{found.says}\n")
    for what, path in (
        ("the page", page),
        ("the same results as numbers", numbers),
        ("the augmented stage", output / "stage.pt"),
        ("what to record next", output / "next_excitation.csv"),
    ):
        print(f"{path}: {what}")
    return found


def load_simulation(text: str) -> Simulation:
    """Load what `--simulation` names: a stage by its file or name, an FMU, a function, or "column"."""
    if text == COLUMN:
        return COLUMN
    if Path(text).suffix.lower() in (".yaml", ".yml", ".pt") or is_own_config(text, "stage"):
        return Stage.load(text)
    return load_simulator(text)
