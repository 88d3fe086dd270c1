"""Where a run leaves its files, and whether it may."""

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
        self.lock = path / ".lock"  # held by the process that trains here
        self.checkpoints = path / "checkpoints"
        self.best, self.last = self.checkpoints / "best.ckpt", self.checkpoints / "last.ckpt"
        self.metrics, self.report = path / "metrics.json", path / "report.html"
        self.compensator = path / "compensator.pt"  # TorchScript; the JSON of its numbers stands beside it
        self.baseline = path / "baseline.pt"  # two-stage least squares, TorchScript
        self.stage = path / "stage.pt"  # identified from the recordings

    @property
    def events(self) -> list[Path]:
        """Files of TensorBoard, which names a run by the folder that they are in."""
        return sorted(self.path.glob("events.out.tfevents.*"))


def new_run(output: str | None, name: str, checkpoint: str | None) -> RunFolder:
    """The folder of a new run: `output`, or the next free one of that name.

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
    """The folder of the run to go on with: `output`, or the latest of that name.

    Raises:
        ArtifactError: There is none, or it has no checkpoint yet.
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
    """Make the folder, if need be, and hold it as long as this process trains there.

    What a run left that was killed before its first checkpoint is cleared away, unless this one goes on.

    Raises:
        ArtifactError: Another process holds it, or has begun a run in it since it was chosen.
    """
    folder.path.mkdir(parents=True, exist_ok=True)
    handle = os.open(folder.lock, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ArtifactError(
                f"{folder.path}: another process trains into it, expected a folder of its own for each run"
            ) from None
        except OSError:
            pass  # a file system without locks
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
    """Whether a checkpoint is one of the same training.

    Raises:
        ArtifactError: Not a checkpoint, or one of something else.
        ConfigError: Of a compensator with other hyper-parameters.
    """
    found, given = load_compensator(checkpoint).hyper_parameters, compensator.hyper_parameters
    for name in given:
        if found[name] != given[name]:
            raise ConfigError(
                f"{checkpoint}: trained with {name} {found[name]}, but these settings and recordings make it "
                f"{given[name]}; go on with those it was started with, or start a new run"
            )


def _free(name: str) -> Path:
    taken = _numbered(name)
    number = len(taken) + 1
    return RUNS / (name if number == 1 else f"{name}-{number}")


def _numbered(name: str) -> list[Path]:
    """runs/NAME, runs/NAME-2, … as far as they exist."""
    paths: list[Path] = []
    while (path := RUNS / (f"{name}-{len(paths) + 1}" if paths else name)).exists():
        paths.append(path)
    return paths


def _ended_early(folder: RunFolder) -> bool:
    """Whether the folder holds nothing but the beginnings of a run that has no checkpoint to go on with."""
    own = {folder.lock, folder.config, folder.facts, *folder.events, folder.checkpoints}
    entries = set(folder.path.iterdir())
    temporary = {one for one in entries if one.name.startswith((".config-", ".run-"))}
    return folder.lock in entries and not folder.last.is_file() and entries - temporary <= own


def _contents(folder: RunFolder) -> str:
    if folder.last.is_file():
        state = "a finished run" if folder.metrics.is_file() else "a run that was interrupted"
        return f"holds {state}; go on with it by --ckpt_path last, or name another folder"
    first = min(entry.name for entry in folder.path.iterdir() if entry != folder.lock)
    return f"is in use (it holds '{first}'), expected a new or empty folder"
