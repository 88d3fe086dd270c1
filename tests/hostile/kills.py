"""Commands that are killed at random moments, and what must hold afterwards."""

import contextlib
import json
import math
import random
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
import yaml

from tests.hostile.sequences import compensator
from torchpi.control.trained import to_checkpoint
from torchpi.recordings.recording import Recording, write_recording

ROOT = Path(__file__).parents[2]
SIGNALS = (signal.SIGTERM, signal.SIGKILL, signal.SIGINT)
GONE_WITHIN_S = 2.0


@dataclass(frozen=True)
class Command:
    """A command line, and the folder that holds everything it writes.

    Attributes:
        arguments: For `python -m`.
        output: Its folder; whatever a killed run leaves there, the next run must succeed.
        again: Gives the command line after a kill, if it differs.
        checkout: Folder in which it runs.
    """

    arguments: Sequence[str]
    output: Path
    again: Callable[[], Sequence[str]] | None = None
    checkout: Path = ROOT


@dataclass
class Outcome:
    """Results of killing one command.

    Attributes:
        kills: By name of the signal, how many came before the command had ended.
        faults: A line for each violation.
    """

    kills: dict[str, int] = field(default_factory=lambda: {one.name: 0 for one in SIGNALS})
    faults: list[str] = field(default_factory=list)


def commands(folder: Path) -> dict[str, Command]:
    """Return a small command of each kind, with the files it needs in a prepared folder."""
    (folder / "recordings").mkdir(parents=True)
    paths = []
    for seed in range(2):
        paths.append(str(folder / "recordings" / f"{seed}.csv"))
        write_recording(paths[-1], recording(seed))
    run = folder / "run" / "checkpoints"
    run.mkdir(parents=True)
    torch.save(to_checkpoint(compensator()), run / "best.ckpt")
    fit = [
        "train",
        "fit",
        "--data.recordings",
        json.dumps(paths),
        "--model.plays=5",
        "--trainer.max_epochs=6",
        "--trainer.figures_every=0",
        "--output",
        str(folder / "fit"),
    ]
    last = folder / "fit" / "checkpoints" / "last.ckpt"

    def fit_again() -> Sequence[str]:
        finished = (folder / "fit" / "metrics.json").is_file()
        if finished:
            shutil.rmtree(folder / "fit")
        return [*fit, "--ckpt_path", "last"] if last.is_file() else fit

    def reproduce_again() -> Sequence[str]:
        if (paper / "paper.html").is_file():  # otherwise it would only read its stored results
            shutil.rmtree(paper)
        return reproduce

    stage = str(ROOT / "configs/stage/qin2013.yaml")
    exported, checked, diagnosis = folder / "export", folder / "check", folder / "diagnosis"
    paper = folder / "paper"
    reproduce = ["torchpi", "reproduce", "--only", "fig8", "--stage", stage, "--output", str(paper)]
    return {
        "fit": Command(fit, folder / "fit", fit_again),
        "export": Command(
            [
                "torchpi",
                "export",
                str(run.parent),
                "--to",
                "torchscript,c,json,page",
                "--allow_backwards",
                "true",
                "--output",
                str(exported / "c"),
            ],
            exported,
        ),
        "diagnose": Command(["torchpi", "diagnose", paths[0], "--output", str(diagnosis)], diagnosis),
        "reproduce": Command(reproduce, paper, reproduce_again),
        "check": Command(["torchpi", "check", *paths, "--output", str(checked)], checked),
    }


def figures(folder: Path) -> Command:
    """Return the command of `make figures` for two measurements, in its own checkout: it writes into it."""
    checkout = folder / "checkout"
    listed = git(ROOT, "ls-files", "-co", "--exclude-standard").splitlines()
    for name in filter(lambda name: (ROOT / name).is_file(), listed):
        (checkout / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, checkout / name)
    shutil.rmtree(checkout / "docs" / "_templates")  # page fragments, whose ends are arbitrary
    git(checkout, "init")
    git(checkout, "add", ".")
    git(checkout, "-c", "user.name=a test", "-c", "user.email=", "commit", "-m", "a copy")
    recordings = ROOT.parent / "shared"
    if recordings.is_dir():
        (folder / "shared").symlink_to(recordings)
    last = "piezo_stack_um" if recordings.is_dir() else "stage_reach_um"
    record = checkout / "docs" / "figures.json"
    before = json.loads(record.read_text(encoding="utf-8"))
    for entry in before["figures"].values():
        entry["code_sha256"] = ""  # matches no code, so all are due
    record.write_text(json.dumps(before) + "\n", encoding="utf-8")
    measure = ["benchmarks.figures", "--only", "stage,piezo_stack"]

    def again() -> Sequence[str]:
        if json.loads(record.read_text(encoding="utf-8"))["figures"][last]["code_sha256"]:
            record.write_text(json.dumps(before) + "\n", encoding="utf-8")  # otherwise nothing is due
        return measure

    return Command(measure, record.parent, again, checkout)


def git(folder: Path, *words: str) -> str:
    done = subprocess.run(["git", *words], cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout


def recording(seed: int) -> Recording:
    """Return two plays and a quadratic term of a smooth random voltage, 1 s at 500 Hz."""
    random_ = np.random.default_rng(seed)
    t = np.arange(500) / 500.0
    wave = sum(np.sin(2 * np.pi * f * t + random_.uniform(0, 6)) for f in (2, 3, 5, 7))
    u = 5 * (1 + wave / 4) * (1 - np.exp(-t / 0.05))
    h = np.zeros(len(t))
    for k in range(1, len(t)):
        h[k] = max(u[k] - 0.5, min(u[k] + 0.5, h[k - 1]))
    y = 0.6 * u + 0.3 * h + 0.004 * u**2 + random_.normal(0, 2e-3, len(t))
    return Recording(f"r{seed}", t, u, y, 500.0)


def kill_often(
    command: Command,
    rounds: int,
    seed: int = 0,
    finish_every: int = 1,
    watch: Callable[[Outcome], None] = lambda outcome: None,
) -> Outcome:
    """Kill a command until `rounds` signals of each kind came in time, at moments spread over its run.

    Every run starts from what the previously killed run left, and must not fail by itself. After each
    `finish_every`-th kill, and after the last, the command is run to its end.

    Args:
        command: Command to run.
        rounds: How many signals of each kind.
        seed: Seed of the moments.
        finish_every: Number of kills between two runs to the end.
        watch: Called with the outcome so far after each run to the end.
    """
    rng, outcome, started = random.Random(seed), Outcome(), time.monotonic()
    done = finish(command, again=False)
    if done.returncode:
        raise RuntimeError(f"{command.arguments}: {done.stderr}")
    lasts_s = time.monotonic() - started
    tries = [(share, one) for share in range(rounds) for one in SIGNALS]
    for count in range(2 * len(tries)):
        missing = [(share, one) for share, one in tries if outcome.kills[one.name] < rounds]
        if not missing:
            break
        share, one = missing[count % len(missing)]
        at_s = (0.05 + 0.95 * (share + rng.random()) / rounds) * lasts_s
        # The first run may have compiled, and a shared machine may have become faster.
        lasts_s = min(lasts_s, kill_once(command, one, at_s, outcome))
        last = sum(outcome.kills.values()) == len(tries)
        if last or (count + 1) % finish_every == 0:
            done = finish(command, again=True)
            what = f"after {one.name} at {at_s:.2f} s"
            if done.returncode:
                outcome.faults.append(f"{what}: the next run failed, {done.stderr[-300:]}")
            outcome.faults += [f"{what}: {path.name} is left" for path in temporaries(command.output)]
            watch(outcome)
    return outcome


def kill_once(command: Command, one: signal.Signals, at_s: float, outcome: Outcome) -> float:
    """Start a command, send it the signal `at_s` seconds later, and check what it leaves.

    Returns:
        Duration of the run, s; infinity if it was killed.
    """
    arguments = line(command, again=True)  # may clear a finished run
    before = {path: path.read_bytes() for path in files(command.output)}
    process = subprocess.Popen(
        [sys.executable, "-m", *arguments],
        cwd=command.checkout,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    started = time.monotonic()
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(at_s)
    lasted_s = time.monotonic() - started
    children = descendants(process.pid)
    killed = process.poll() is None
    process.send_signal(one)
    _, error = process.communicate()
    outcome.kills[one.name] += killed
    what = f"{one.name} after {at_s:.2f} s"
    if not killed and process.returncode:
        outcome.faults.append(f"{what}: it had failed by itself, {error[-300:]}")
    gone_by = time.monotonic() + GONE_WITHIN_S
    while any(map(alive, children)) and time.monotonic() < gone_by:
        time.sleep(0.02)
    if any(map(alive, children)):
        outcome.faults.append(f"{what}: processes go on")
    if "Traceback" in error and at_s > 2.0:  # until then, Python itself is starting
        outcome.faults.append(f"{what}: a traceback, {error.splitlines()[-1]}")
    for path in {*files(command.output), *before}:
        if not whole(path):
            outcome.faults.append(f"{what}: {path.name} is not whole")
    return math.inf if killed else lasted_s


def line(command: Command, again: bool) -> Sequence[str]:
    return command.again() if again and command.again else command.arguments


def finish(command: Command, again: bool) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-m", *line(command, again)]
    return subprocess.run(words, cwd=command.checkout, capture_output=True, text=True)


def temporaries(folder: Path) -> list[Path]:
    return [path for path in folder.rglob(".*") if path.name != ".lock"]


def files(folder: Path) -> list[Path]:
    """Return the files that a run left, except TensorBoard events, which are appended to."""
    found = [path for path in folder.rglob("*") if path.is_file() and not path.name.startswith(".")]
    return [path for path in found if "tfevents" not in path.name]


def whole(path: Path) -> bool:
    """Whether a file exists and is complete according to its format."""
    if not path.is_file():
        return False
    content = path.read_bytes()
    try:
        match path.suffix:
            case ".json":
                json.loads(content)
            case ".yaml":
                return bool(yaml.safe_load(content))
            case ".pt" | ".ckpt" | ".npz" | ".pt2":
                with zipfile.ZipFile(path) as archive:
                    return archive.testzip() is None
            case ".html" | ".svg":
                return content.rstrip().endswith((b"</html>", b"</svg>"))
            case ".png":
                return content.endswith(b"IEND\xaeB`\x82")
            case _:
                return content.endswith(b"\n")
    except (ValueError, yaml.YAMLError, zipfile.BadZipFile):
        return False
    return True


def descendants(process: int) -> list[int]:
    """Return the children of a process and their descendants, from /proc."""
    found = []
    for file in Path("/proc").glob(f"{process}/task/*/children"):
        try:
            children = [int(child) for child in file.read_text().split()]
        except OSError:
            continue  # it has just ended
        for child in children:
            found += [child, *descendants(child)]
    return found


def alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
