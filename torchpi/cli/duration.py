"""Estimate the duration of a command from the size of its files and the current speed of this machine.

The estimate is printed before anything heavy is imported, so that it appears within two seconds. The work of
each command is counted in processor seconds of one core of an AMD EPYC; `machine.py` measures how many of
them this machine currently delivers per second. The duration of a diagnosis depends on how much it finds, so
the remaining time is printed after each round.
"""

import contextlib
import itertools
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import yaml

from torchpi.cli.machine import measured
from torchpi.cli.workers import MOST_WORKERS, available_cores
from torchpi.errors import ConfigError
from torchpi.files import PACKAGE, config_file

FIRST_LINES = 1 << 16
"""Bytes of a text file from which the length of its lines is estimated."""
BINARY_SAMPLE = 24
"""Bytes of one sample with three doubles."""
TEXTS = (".csv", ".txt", ".dat", ".tsv", ".asc", ".lvm")
PAPER_S = {"slow": 2.0, "fast": 1.0}
"""Durations of the paper's trajectories."""
SEVERAL_AXES_S = 480.0
AXES_S = 25.0
"""Duration of a diagnosis of several axes without its final fit."""
GROUPS = ("data", "model", "trainer")
USUAL_HZ = 10_000.0
"""Sample rate of the built-in stages; that of others is unknown before torch is imported."""
MOST_SAMPLES = 100_000
"""Most samples that a diagnosis works on; longer recordings are taken at a lower rate."""
FEWEST_ROUNDS, USUAL_ROUNDS, MOST_ROUNDS = 2, 5, 7
"""Numbers of rounds of a search that finds effects; one that finds none has a single round."""
DIAGNOSIS_S, DRAWING_S = 4.5, 8.0
"""Duration of a diagnosis without its rounds, and of the drawing of figures after the decision. Every search
has a first round, in which most of the drawing time is counted."""
ROUND_S, SAMPLE_S = 8.5, 5.2e-4
"""Duration of the first round of a search, fixed and per sample, with its share of the decision. It lies
between those of two machines equally fast in a Python loop, one 1.7 times as slow in a diagnosis."""
GROWTH = 0.75
"""Exponent with which the duration of a search grows with the number of rounds."""
DECISION = 0.1
"""Duration of the decision relative to that of the search."""
SERIAL = 0.6
"""Fraction of a search that this process does alone while its workers are idle."""


def announce_check(files: Iterable[str | Path]) -> None:
    """Print the estimate for `torchpi check`."""
    sizes = _samples_in(files)
    _announce_work(3.2 + 0.25 * len(sizes) + 8e-6 * sum(sizes))


def announce_run(trajectories: str | Sequence[str], compared: int) -> None:
    """Print the estimate for `torchpi run` with this number of compensators to compare."""
    names = [trajectories] if isinstance(trajectories, str) else trajectories
    own = _samples_in(name for name in names if name not in PAPER_S)
    samples = sum(own) + sum(USUAL_HZ * PAPER_S.get(name, 0.0) for name in names)
    _announce_work(4.0 + 3.5 * len(names) + 2.0 * compared + 4e-5 * (3 + compared) * samples, "stage", 10.0)


def announce_diagnose(recordings: Iterable[str | Path]) -> None:
    """Print the estimates for `torchpi diagnose` if nothing is missing, and if little or much is.

    The number of rounds of the search is not known in advance.
    """
    samples = min(sum(_samples_in(recordings)), MOST_SAMPLES)
    compile_s = 0.0 if _compiled("diagnosis") else 60.0
    machine = measured(min(available_cores(), 1 + MOST_WORKERS))
    alone = DIAGNOSIS_S + compile_s
    work = [search_s(n, samples) for n in (1, FEWEST_ROUNDS, MOST_ROUNDS)]
    nothing, least, most = (machine.seconds(alone + SERIAL * s, (1 - SERIAL) * s) for s in work)
    range_said = " to ".join(dict.fromkeys((_spoken(least), _spoken(most))))
    note = f" if nothing is missing, {range_said} if something is"
    _announce(nothing, note + _compiles(compile_s, alone + search_s(USUAL_ROUNDS, samples)))


def announce_axes(recordings: Iterable[str | Path], seconds: float) -> None:
    """Print the estimate for `torchpi diagnose` of several axes, whose final fit has a given time."""
    work_s = AXES_S + 5e-4 * sum(_samples_in(recordings))
    _announce(seconds + measured(min(available_cores(), 2)).seconds(work_s))


def search_s(rounds: int, samples: int) -> float:
    """Return the duration of a search with its decision for this number of rounds and samples."""
    seconds: float = (ROUND_S + SAMPLE_S * samples) * rounds**GROWTH
    return seconds


class Countdown:
    """Estimates the remaining time of a diagnosis from the duration of its rounds so far."""

    def __init__(self) -> None:
        self.retuned_s, self.rounds = 0.0, 0

    def left(self, sentence: str, elapsed_s: float) -> str:
        """Return the text to append to a progress message after a successful round and at the decision."""
        if sentence.startswith("retuned"):
            self.retuned_s = elapsed_s
        elif found := re.match(r"round (\d+):", sentence):
            self.rounds = int(found[1])
        searched_s = elapsed_s - self.retuned_s
        if sentence.startswith("decide"):
            return self._said(DECISION * searched_s)
        if sentence.startswith("  with ") and self.rounds < MOST_ROUNDS:
            # Assume at least one more round that finds something and a last one that finds nothing.
            last = min(max(self.rounds + 2, USUAL_ROUNDS), MOST_ROUNDS)
            ahead = (last / self.rounds) ** GROWTH
            return self._said(((1.0 + DECISION) * ahead - 1.0) * searched_s)
        return ""

    def _said(self, seconds: float) -> str:
        return f"; about {_spoken(seconds + measured(1).seconds(DRAWING_S))} left"


def announce_fit(arguments: Sequence[str]) -> None:
    """Print the estimate for `torchpi train` with these arguments, unless nothing is trained."""
    if arguments[:1] != ["fit"] or any(word.startswith(("-h", "--help", "--print")) for word in arguments):
        return
    with contextlib.suppress(ConfigError, OSError, yaml.YAMLError, AttributeError, TypeError, ValueError):
        data, model, trainer, several, oscillator = _settings(arguments)
        if several:
            # A stage of several axes is fitted for a given time, independent of the machine.
            print(
                f"This will take up to {_spoken(float(several.get('seconds', SEVERAL_AXES_S)))}.", flush=True
            )
            return
        if oscillator:
            # The fit takes 130 simulations of all samples after a search of fixed length.
            _announce_work(
                15.0 + 2e-4 * sum(_samples_in(oscillator.get("recordings") or ())), "operators", 10.0
            )
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
        _announce_work(12.0 + (4e-4 * samples if model.get("select") else by_epochs), "identification", 40.0)


def _settings(arguments: Sequence[str]) -> tuple[dict[str, Any], ...]:
    """Return the config sections that determine the duration, updated with the command-line options."""
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


def _announce(seconds: float, note: str = "") -> None:
    print(f"This will take about {_spoken(seconds)}{note}.", flush=True)


def _announce_work(processor_s: float, compiles: str = "", compile_s: float = 0.0) -> None:
    """Print the estimated duration of an amount of work.

    Args:
        processor_s: Seconds of one processor with kernels already compiled.
        compiles: Part of the package whose kernels are needed.
        compile_s: Seconds to compile these kernels at the first use of an installation.
    """
    first_s = compile_s if compiles and not _compiled(compiles) else 0.0
    seconds = measured(1).seconds(processor_s + first_s)
    _announce(seconds, _compiles(first_s, processor_s + first_s))


def _compiles(first_s: float, all_s: float) -> str:
    return ", mostly for a one-time compilation" if first_s > 0.5 * all_s else ""


def _spoken(seconds: float) -> str:
    """Format a duration with the precision of an estimate: `8 s`, `40 s`, `3 min`."""
    if seconds < 10:
        return f"{max(1, round(seconds))} s"
    return f"{10 * round(seconds / 10)} s" if seconds < 95 else f"{round(seconds / 60)} min"


def _samples_in(paths: Iterable[str | Path]) -> list[int]:
    """Estimate the number of samples in each file; unreadable files count as 0."""
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
    """Whether the kernels of this part of the package have been compiled before."""
    elsewhere = os.environ.get("NUMBA_CACHE_DIR")
    beside = (PACKAGE / part / "__pycache__").glob("*.nbi")
    return any(beside) or bool(elsewhere and any(Path(elsewhere).glob(f"{part}_*/*.nbi")))
