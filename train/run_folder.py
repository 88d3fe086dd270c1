"""The folder of a run: its files, and whether a run may use it."""

import contextlib
import fcntl
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from torchpi.control.direct_inverse import DirectInverse
from torchpi.control.trained import load_compensator
from torchpi.errors import ArtifactError, ConfigError
from torchpi.files import check_output_folder

RUNS = Path("runs")


class RunFolder:
    """The files of a run, by what they are. Making one creates nothing.

    Args:
        path: Of the folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.config = path / "config.yaml"
        self.facts = path / "run.json"  # seed, hashes of the data, versions
        self.lock = path / ".lock"  # held by the process that trains in this folder
        self.checkpoints = path / "checkpoints"
        self.best, self.last = self.checkpoints / "best.ckpt", self.checkpoints / "last.ckpt"
        self.metrics, self.report = path / "metrics.json", path / "report.html"
        self.compensator = path / "compensator.pt"  # TorchScript; its numbers are in the JSON beside it
        self.baseline = path / "baseline.pt"  # two-stage least squares, TorchScript
        self.stage = path / "stage.pt"  # identified from the recordings

    @property
    def events(self) -> list[Path]:
        """TensorBoard event files; TensorBoard names a run after the folder they are in."""
        return sorted(self.path.glob("events.out.tfevents.*"))


def new_run(output: str | None, name: str, checkpoint: str | None) -> RunFolder:
    """Return the folder of a new run: `output`, or the next free folder with this name.

    Raises:
        ArtifactError: `output` is a file, is in use or cannot be written to; the checkpoint to start from is
            missing.
    """
    if checkpoint is not None and not Path(checkpoint).is_file():
        raise ArtifactError(f"--ckpt_path {checkpoint}: no such file, expected 'last' or a checkpoint")
    if output is None:
        return RunFolder(_free(name))
    path = Path(output)
    check_output_folder(path)
    folder = RunFolder(path)
    if path.is_dir() and any(path.iterdir()) and not _ended_early(folder):
        raise ArtifactError(f"--output {output}: {_contents(folder)}")
    return folder


def run_to_continue(output: str | None, name: str) -> RunFolder:
    """Return the folder of the run to continue: `output`, or the latest with this name.

    Raises:
        ArtifactError: There is no such run, or it has no checkpoint yet.
    """
    if output is not None:
        folder = RunFolder(Path(output))
    else:
        started = [path for path in _numbered(name) if RunFolder(path).last.is_file()]
        if not started:
            raise ArtifactError(
                f"--ckpt_path last: no run with a checkpoint at {RUNS / name}; "
                "name its folder with --output, or leave out --ckpt_path"
            )
        folder = RunFolder(started[-1])
    if not folder.last.is_file():
        raise ArtifactError(
            f"--ckpt_path last: no {folder.last}; name a run's folder with --output, or leave out --ckpt_path"
        )
    return folder


@contextlib.contextmanager
def claim(folder: RunFolder, goes_on: bool) -> Iterator[None]:
    """Create the folder if necessary, and lock it while this process trains in it.

    Files of a run that was killed before its first checkpoint are removed, unless this run continues it.

    Raises:
        ArtifactError: Another process holds the folder, or has started a run in it since it was chosen.
    """
    folder.path.mkdir(parents=True, exist_ok=True)
    handle = os.open(folder.lock, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ArtifactError(
                f"{folder.path}: another process is training in it, expected a separate folder for each run"
            ) from None
        except OSError:
            pass  # the file system has no locks
        if not goes_on:
            if any(entry != folder.lock for entry in folder.path.iterdir()) and not _ended_early(folder):
                raise ArtifactError(f"{folder.path}: {_contents(folder)}")
            for file in folder.events:
                file.unlink(missing_ok=True)
            shutil.rmtree(folder.checkpoints, ignore_errors=True)
        yield
    finally:
        os.close(handle)


def check_continues(checkpoint: Path, compensator: DirectInverse) -> None:
    """Check that a checkpoint belongs to the same training.

    Raises:
        ArtifactError: The file is not a checkpoint of a compensator.
        ConfigError: The compensator of the checkpoint has other hyper-parameters.
    """
    found, given = load_compensator(checkpoint).hyper_parameters, compensator.hyper_parameters
    for name in given:
        if found[name] != given[name]:
            raise ConfigError(
                f"{checkpoint}: trained with {name} {found[name]}, but these settings and recordings give "
                f"{given[name]}; continue with those it was started with, or start a new run"
            )


def _free(name: str) -> Path:
    taken = _numbered(name)
    number = len(taken) + 1
    return RUNS / (name if number == 1 else f"{name}-{number}")


def _numbered(name: str) -> list[Path]:
    """List runs/NAME, runs/NAME-2, … as far as they exist."""
    paths: list[Path] = []
    while (path := RUNS / (f"{name}-{len(paths) + 1}" if paths else name)).exists():
        paths.append(path)
    return paths


def _ended_early(folder: RunFolder) -> bool:
    """Whether the folder holds only the first files of a run that has no checkpoint to continue from."""
    own = {folder.lock, folder.config, folder.facts, *folder.events, folder.checkpoints}
    entries = set(folder.path.iterdir())
    temporary = {one for one in entries if one.name.startswith((".config-", ".run-"))}
    return folder.lock in entries and not folder.last.is_file() and entries - temporary <= own


def _contents(folder: RunFolder) -> str:
    if folder.last.is_file():
        state = "a finished run" if folder.metrics.is_file() else "a run that was interrupted"
        return f"holds {state}; continue it with --ckpt_path last, or name another folder"
    first = min(entry.name for entry in folder.path.iterdir() if entry != folder.lock)
    return f"is in use (it holds '{first}'), expected a new or empty folder"
