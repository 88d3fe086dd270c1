"""How long a command will take: from the size of its files, and from how quick this machine is right now.

Printed before anything heavy is imported, so that it stands there within two seconds. The seconds of each
command were measured on one core of an AMD EPYC; a loop that was timed there shows how much slower or quicker
this machine is. It is an estimate for recordings of the usual kind: what a diagnosis finds decides how long
it goes on.
"""

import contextlib
import itertools
import math
import os
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import yaml

from torchpi.errors import ConfigError
from torchpi.files import PACKAGE, config_file

PROBE_LOOPS, PROBE_S = 300_000, 0.038
"""A loop of plain Python, and how long it took where the seconds below were measured."""
FIRST_LINES = 1 << 16
"""Bytes of a text by which the length of its lines is judged."""
BINARY_SAMPLE = 24
"""Bytes of a sample of three doubles."""
TEXTS = (".csv", ".txt", ".dat", ".tsv", ".asc", ".lvm")
PAPER_S = {"slow": 2.0, "fast": 1.0}
"""Of the paper's trajectories."""
SEVERAL_AXES_S = 480.0
GROUPS = ("data", "model", "trainer")
USUAL_HZ = 10_000.0
"""Of the built-in stages; that of others is not known before torch is there."""


def announce_check(files: Iterable[str | Path]) -> None:
    """Before `torchpi check`."""
    sizes = _samples_in(files)
    _announce(3.2 + 0.25 * len(sizes) + 8e-6 * sum(sizes))


def announce_run(trajectories: str | Sequence[str], compared: int) -> None:
    """Before `torchpi run`, with so many compensators to compare."""
    names = [trajectories] if isinstance(trajectories, str) else trajectories
    own = _samples_in(name for name in names if name not in PAPER_S)
    samples = sum(own) + sum(USUAL_HZ * PAPER_S.get(name, 0.0) for name in names)
    _announce(6.0 + 5.5 * len(names) + 3.0 * compared + 1.2e-4 * (3 + compared) * samples, "stage", 10.0)


def announce_diagnose(recordings: Iterable[str | Path]) -> None:
    """Before `torchpi diagnose`."""
    sizes = _samples_in(recordings)
    # Two cores share it. Each recording of another motion brings more to light, and so more rounds.
    _announce(20.0 + 35.0 * (len(sizes) - 1) + 5e-4 * min(sum(sizes), 400_000), "diagnosis", 60.0)


def announce_fit(arguments: Sequence[str]) -> None:
    """Before `torchpi train`, by what follows it; silent where nothing is trained."""
    if arguments[:1] != ["fit"] or any(word.startswith(("-h", "--help", "--print")) for word in arguments):
        return
    with contextlib.suppress(ConfigError, OSError, yaml.YAMLError, AttributeError, TypeError, ValueError):
        data, model, trainer, several, oscillator = _settings(arguments)
        if several:
            # A stage of several axes is fitted for a given time, however quick the machine.
            print(
                f"This will take up to {_spoken(float(several.get('seconds', SEVERAL_AXES_S)))}.", flush=True
            )
            return
        if oscillator:
            # 130 simulations of all samples, after a search of fixed length.
            _announce(15.0 + 2e-4 * sum(_samples_in(oscillator.get("recordings") or ())), "operators", 10.0)
            return
        files = [*(data.get("recordings") or ()), *(data.get("heldout") or ())]
        simulate = data.get("simulate") or {}
        played = [one for part in ("train", "heldout") for one in simulate.get(part) or ()]
        samples = sum(_samples_in(files)) + USUAL_HZ * sum(one.get("duration_s", 1.0) for one in played)
        follow = data.get("follow") or {}
        motions = [one for part in ("train", "heldout") for one in follow.get(part) or ()]
        followed = USUAL_HZ * follow.get("duration_s", 1.0) * len(motions)
        epochs = int(trainer.get("max_epochs", 60))
        by_epochs = 1.5e-4 * samples + epochs * (2.5e-6 * samples + 4e-6 * followed)
        _announce(12.0 + (4e-4 * samples if model.get("select") else by_epochs), "identification", 40.0)


def _settings(arguments: Sequence[str]) -> tuple[dict[str, Any], ...]:
    """Sections of the config, with the options after it, as far as they tell of time."""
    words = [part for word in arguments[1:] for part in (word.split("=", 1) if word[:2] == "--" else [word])]
    given = dict(itertools.pairwise(words))
    config = given.get("--config") or given.get("-c")
    read = yaml.safe_load(config_file(config).read_text(encoding="utf-8")) if config else {}
    groups = {name: dict(read.get(name) or {}) for name in (*GROUPS, "multi_axis", "oscillator")}
    for option, value in given.items():
        group, _, name = option.removeprefix("--").partition(".")
        if group in GROUPS and name:
            groups[group][name] = yaml.safe_load(value)
    return tuple(groups.values())


def _announce(seconds: float, compiles: str = "", compile_s: float = 0.0) -> None:
    """Print about how long it will take, of `seconds` as measured.

    Args:
        seconds: With compiled kernels there.
        compiles: The part of the package whose kernels are needed.
        compile_s: What compiling them takes, at the first use of an installation.
    """
    first = bool(compiles) and not _compiled(compiles)
    note = ", most of it to compile, this once" if first and compile_s > seconds else ""
    print(f"This will take about {_spoken((seconds + compile_s * first) * _pace())}{note}.", flush=True)


def _spoken(seconds: float) -> str:
    """`8 s`, `40 s`, `3 min`: the digits that an estimate has."""
    if seconds < 10:
        return f"{max(1, round(seconds))} s"
    return f"{10 * round(seconds / 10)} s" if seconds < 95 else f"{round(seconds / 60)} min"


def _pace() -> float:
    """How many times as long as measured this machine takes.

    The geometric mean of two answers: how quick its processor is, and how busy the machine is in this moment,
    which may pass.
    """
    wall, processor, x = time.perf_counter(), time.process_time(), 0
    for _ in range(PROBE_LOOPS):
        x = (x * 1103515245 + 12345) & 0x7FFFFFFF
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    return math.sqrt(wall * processor) / PROBE_S


def _samples_in(paths: Iterable[str | Path]) -> list[int]:
    """About how many samples each of these files holds; one that cannot be read counts none."""
    return [_samples(Path(path)) for path in paths]


def _samples(path: Path) -> int:
    with contextlib.suppress(OSError):
        size = path.stat().st_size if path.is_file() else 0
        if path.suffix.lower() not in TEXTS:
            return size // BINARY_SAMPLE
        if size:
            with open(path, "rb") as file:
                first = file.read(FIRST_LINES)
            return size * first.count(b"\n") // len(first)
    return 0


def _compiled(part: str) -> bool:
    """Whether kernels of this part of the package have been compiled before."""
    elsewhere = os.environ.get("NUMBA_CACHE_DIR")
    beside = (PACKAGE / part / "__pycache__").glob("*.nbi")
    return any(beside) or bool(elsewhere and any(Path(elsewhere).glob(f"{part}_*/*.nbi")))
