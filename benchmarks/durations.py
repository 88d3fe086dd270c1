"""Check the time estimates that commands print first, and refit the constants of a diagnosis's estimate.

    python benchmarks/durations.py [--only check,fit,run,diagnose] [--rounds]

Runs the README's commands that estimate their time, in a temporary folder, and prints for each the estimate,
the time taken, and the ratio of the two, which should lie between a half and two; then does the same for
diagnoses in which nothing is missing. With `--rounds` it then diagnoses several sets of the README's
recordings and fits the constants of `torchpi/cli/duration.py` to their processor time as a function of
samples and rounds. The constants are printed again after each set from the fourth on:

    processor s = DIAGNOSIS_S + (ROUND_S + SAMPLE_S · samples) · rounds^GROWTH

Every line is printed as soon as it is known, so results remain valid if this program is stopped early.
"""

import argparse
import re
import resource
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import nnls

sys.path.insert(0, str(Path(__file__).parents[1]))

from torchpi.cli.machine import measured

README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
NULLS = tuple(
    f"torchpi diagnose {files} --simulation default --output nothing"
    for files in ("recordings/slow.csv", "recordings/slow.csv recordings/judge.csv", "recordings/*.csv")
)
"""Diagnoses in which the recordings come from the same stage as the simulation."""
MARKS = {"check": "torchpi check", "fit": "train fit", "run": "torchpi run", "diagnose": "torchpi diagnose"}
SETS = (
    ("slow",), ("fast",), ("slow", "judge"), ("triangles", "judge"), ("slow", "triangles", "judge"),
    ("slow", "fast", "triangles", "judge"),
)  # fmt: skip


@dataclass(frozen=True)
class Ran:
    """A command that has ended.

    Attributes:
        seconds: Wall-clock time.
        processor_s: Processor time with its child processes, scaled to the constants' reference machine.
        estimated_s: The estimate (of a diagnosis, the one that suits its outcome); NaN if there was none.
        rounds: Rounds of the search, if it is a diagnosis.
    """

    seconds: float
    processor_s: float
    estimated_s: float
    rounds: int


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default=",".join(MARKS), help="the commands whose estimates are compared")
    parser.add_argument("--rounds", action="store_true", help="measure the constants of a diagnosis")
    options = parser.parse_args()
    compared = [MARKS[name] for name in options.only.split(",") if name]
    with tempfile.TemporaryDirectory() as temporary:
        folder, wrong = Path(temporary), 0
        for command in [*commands(), *NULLS]:
            if any(mark in command for mark in compared):
                ran = run(words(command, folder), folder)
                ratio = ran.estimated_s / ran.seconds
                wrong += not 0.5 <= ratio <= 2
                print(
                    f"{ran.estimated_s:5.0f} s estimated, {ran.seconds:5.0f} s taken, "
                    f"{ran.processor_s:5.0f} processor s, {ratio:4.2f}: {command}",
                    flush=True,
                )
            elif any(mark in command for mark in needed(compared)):
                run(words(command, folder), folder)
        if options.rounds:
            print_constants(folder)
    return 1 if wrong else 0


def commands() -> list[str]:
    """Return the README's shell lines."""
    return [
        line for block in re.findall(r"```sh\n(.*?)```", README, re.DOTALL) for line in block.splitlines()
    ]


def words(command: str, folder: Path) -> list[str]:
    """Split a command into words as the shell would in this folder."""
    files = (sorted(folder.glob(word)) if "*" in word else [word] for word in shlex.split(command))
    return [str(word) for part in files for word in part]


def needed(compared: Sequence[str]) -> tuple[str, ...]:
    """Return the commands that others depend on: a run needs a fit, and the last fit a diagnosis."""
    fit = ("--config recorded", "torchpi export") if MARKS["run"] in compared else ()
    diagnosis = (MARKS["diagnose"],) if MARKS["fit"] in compared else ()
    return ("torchpi simulate", *fit, *diagnosis)


def run(command: Sequence[str], folder: Path) -> Ran:
    before, started = processor_s(), time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", *command], cwd=folder, capture_output=True, text=True, check=False
    )
    seconds = time.perf_counter() - started
    if done.returncode:
        raise SystemExit(f"{shlex.join(command)}: exit {done.returncode}: {done.stderr.strip()[-500:]}")
    rounds = max((int(number) for number in re.findall(r"round (\d+):", done.stdout)), default=0)
    line = re.search(r"This will take about .*", done.stdout)
    said = re.findall(r"(\d+) (s|min)", line[0]) if line else [("nan", "s")]
    each = [float(number) * (60.0 if unit == "min" else 1.0) for number, unit in said]
    # For a diagnosis that finds something, the value within its stated range nearest to the time taken.
    estimated = each[0] if rounds < 2 else float(np.clip(seconds, *each[1:3]))
    return Ran(seconds, (processor_s() - before) * measured(1).speed, estimated, rounds)


def processor_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def print_constants(folder: Path) -> None:
    sets = [" ".join(f"recordings/{name}.csv" for name in names) for names in SETS]
    measured_here = []
    for command in [*(f"torchpi diagnose {files} --output again" for files in sets), *NULLS]:
        ran = run(words(command, folder), folder)
        files = (folder / word for word in words(command, folder) if word.endswith(".csv"))
        samples = sum(file.read_bytes().count(b"\n") - 1 for file in files)
        print(f"{samples:,} samples, {ran.rounds} rounds, {ran.processor_s:.0f} s: {command}", flush=True)
        measured_here.append((samples, ran.rounds, ran.processor_s))
        if len(measured_here) > 3:
            print_fit(*np.array(measured_here).T)


def print_fit(samples: np.ndarray, rounds: np.ndarray, spent: np.ndarray) -> None:
    """Print the constants that minimise the sum of squared relative errors."""
    fits = []
    for growth in np.arange(0.4, 1.6, 0.05):
        grown = rounds**growth
        relative = np.stack([np.ones(len(grown)), grown, samples * grown], 1) / spent[:, None]
        constants, missed = nnls(relative, np.ones(len(grown)))
        fits.append((missed, growth, constants, relative @ constants))
    _, growth, constants, ratios = min(fits, key=lambda fit: fit[0])
    values = "DIAGNOSIS_S = {:.1f}, ROUND_S = {:.2f}, SAMPLE_S = {:.2e}".format(*constants)
    print(f"{values}, GROWTH = {growth:.2f}; they give", end=" ")
    print(f"{', '.join(f'{ratio:.2f}' for ratio in ratios)} of what was measured", flush=True)


if __name__ == "__main__":
    sys.exit(main())
