"""How long a command will take: from the size of its files, and from what this machine gives it right now.

Printed before anything heavy is imported, so that it stands there within two seconds. The work of each
command is counted in processor seconds, those of one core of an AMD EPYC; `machine.py` measures how many of
them a second brings here and now. How long a diagnosis goes on depends on how much it finds: it says what is
left after each round.
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
"""Bytes of a text by which the length of its lines is judged."""
BINARY_SAMPLE = 24
"""Bytes of a sample of three doubles."""
TEXTS = (".csv", ".txt", ".dat", ".tsv", ".asc", ".lvm")
PAPER_S = {"slow": 2.0, "fast": 1.0}
"""Of the paper's trajectories."""
SEVERAL_AXES_S = 480.0
AXES_S = 25.0
"""Of a diagnosis of several axes, besides its last fit."""
GROUPS = ("data", "model", "trainer")
USUAL_HZ = 10_000.0
"""Of the built-in stages; that of others is not known before torch is there."""
MOST_SAMPLES = 200_000
"""That a diagnosis works on; longer recordings are taken at a lower rate."""
FEWEST_ROUNDS, USUAL_ROUNDS, MOST_ROUNDS = 2, 5, 7
"""Of a search that finds anything; one that finds nothing has a single round."""
DIAGNOSIS_S, DRAWING_S = 4.5, 8.0
"""Of a diagnosis, what is counted with no round, and what is left after the decision, when figures are drawn;
a search has a first round always, which most of that is counted with."""
ROUND_S, SAMPLE_S = 8.5, 5.2e-4
"""Of the first round of a search, in all and of a sample, with its share of the decision. Between what two
machines took that run a loop of Python equally fast, one of them 1.7 times as long for a diagnosis."""
GROWTH = 0.75
"""The power of the number of rounds by which a search grows."""
DECISION = 0.1
"""The decision, over the search."""
SERIAL = 0.6
"""Of a search, what this process does alone, while its workers have nothing to do."""


def announce_check(files: Iterable[str | Path]) -> None:
    """Before `torchpi check`."""
    sizes = _samples_in(files)
    _announce_work(3.2 + 0.25 * len(sizes) + 8e-6 * sum(sizes))


def announce_run(trajectories: str | Sequence[str], compared: int) -> None:
    """Before `torchpi run`, with so many compensators to compare."""
    names = [trajectories] if isinstance(trajectories, str) else trajectories
    own = _samples_in(name for name in names if name not in PAPER_S)
    samples = sum(own) + sum(USUAL_HZ * PAPER_S.get(name, 0.0) for name in names)
    _announce_work(4.0 + 3.5 * len(names) + 2.0 * compared + 8e-5 * (3 + compared) * samples, "stage", 10.0)


def announce_diagnose(recordings: Iterable[str | Path]) -> None:
    """Before `torchpi diagnose`: what it takes where nothing is missing, and where little or much is.

    How many rounds the search will have, nobody knows before.
    """
    samples = min(sum(_samples_in(recordings)), MOST_SAMPLES)
    compile_s = 0.0 if _compiled("diagnosis") else 60.0
    machine = measured(min(available_cores(), 1 + MOST_WORKERS))
    alone = DIAGNOSIS_S + compile_s
    work = [search_s(n, samples) for n in (1, FEWEST_ROUNDS, MOST_ROUNDS)]
    nothing, least, most = (machine.seconds(alone + SERIAL * s, (1 - SERIAL) * s) for s in work)
    range_said = " to ".join(dict.fromkeys((_spoken(least), _spoken(most))))
    note = f" where nothing is missing, {range_said} where something is"
    _announce(nothing, note + _compiles(compile_s, alone + search_s(USUAL_ROUNDS, samples)))


def announce_axes(recordings: Iterable[str | Path], seconds: float) -> None:
    """Before `torchpi diagnose` of several axes, whose last fit has a given time."""
    work_s = AXES_S + 5e-4 * sum(_samples_in(recordings))
    _announce(seconds + measured(min(available_cores(), 2)).seconds(work_s))


def search_s(rounds: int, samples: int) -> float:
    """Of so many rounds over so many samples, with the decision."""
    seconds: float = (ROUND_S + SAMPLE_S * samples) * rounds**GROWTH
    return seconds


class Countdown:
    """What is left of a diagnosis, by what its rounds took so far."""

    def __init__(self) -> None:
        self.retuned_s, self.rounds = 0.0, 0

    def left(self, sentence: str, elapsed_s: float) -> str:
        """What to add to a sentence of its progress: where a round found something, and at the decision."""
        if sentence.startswith("retuned"):
            self.retuned_s = elapsed_s
        elif found := re.match(r"round (\d+):", sentence):
            self.rounds = int(found[1])
        searched_s = elapsed_s - self.retuned_s
        if sentence.startswith("decide"):
            return self._said(DECISION * searched_s)
        if sentence.startswith("  with ") and self.rounds < MOST_ROUNDS:
            # At least as if another round found something, and the one after it nothing.
            last = min(max(self.rounds + 2, USUAL_ROUNDS), MOST_ROUNDS)
            ahead = (last / self.rounds) ** GROWTH
            return self._said(((1.0 + DECISION) * ahead - 1.0) * searched_s)
        return ""

    def _said(self, seconds: float) -> str:
        return f"; about {_spoken(seconds + measured(1).seconds(DRAWING_S))} left"


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


def _announce(seconds: float, note: str = "") -> None:
    print(f"This will take about {_spoken(seconds)}{note}.", flush=True)


def _announce_work(processor_s: float, compiles: str = "", compile_s: float = 0.0) -> None:
    """Print about how long it will take.

    Args:
        processor_s: Of one processor, with compiled kernels there.
        compiles: The part of the package whose kernels are needed.
        compile_s: What compiling them takes, at the first use of an installation.
    """
    first_s = compile_s if compiles and not _compiled(compiles) else 0.0
    seconds = measured(1).seconds(processor_s + first_s)
    _announce(seconds, _compiles(first_s, processor_s + first_s))


def _compiles(first_s: float, all_s: float) -> str:
    return ", most of it to compile, this once" if first_s > 0.5 * all_s else ""


def _spoken(seconds: float) -> str:
    """`8 s`, `40 s`, `3 min`: the digits that an estimate has."""
    if seconds < 10:
        return f"{max(1, round(seconds))} s"
    return f"{10 * round(seconds / 10)} s" if seconds < 95 else f"{round(seconds / 60)} min"


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
