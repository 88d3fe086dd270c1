"""Tools that take part: two commands each, and how a case is submitted to them."""

import json
import os
import shlex
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from concealed.cases import read_column
from concealed.plant.physics import Array


class RunError(ValueError):
    """A run that would prove nothing."""


@dataclass(frozen=True)
class Entry:
    """Command templates with {recordings}, {out}, {input}, {prediction}; without `predict` no prediction."""

    name: str
    diagnose: str
    predict: str = ""
    timeout_s: float = 900.0

    def check_programs(self) -> None:
        """Raise RunError if a command's program is not on PATH."""
        for command in filter(None, (self.diagnose, self.predict)):
            program = shlex.split(command)[0].replace("{python}", sys.executable)
            if shutil.which(program) is None:
                raise RunError(f"entry {self.name}: found no program '{program}', expected it on PATH")


PYTHON = "{python} -m concealed.rivals"


def _rival(name: str) -> Entry:
    return Entry(
        name,
        f"{PYTHON}.{name} diagnose {{recordings}} --output {{out}}",
        f"{PYTHON}.{name} predict {{out}}/stage.json {{input}} --output {{prediction}}",
    )


ENTRIES = {
    entry.name: entry
    for entry in (
        Entry(
            "torchpi",
            "torchpi diagnose {recordings} --resample true --output {out}",  # in case samples are uneven
            "torchpi predict {out}/stage.pt {input} --output {prediction}",
        ),
        _rival("baseline"),
        _rival("sindy"),
        _rival("lisdd"),
        Entry("most_frequent", f"{PYTHON}.blind most_frequent {{recordings}} --output {{out}}"),
        Entry("guess", f"{PYTHON}.blind guess {{recordings}} --output {{out}}"),
    )
}


@dataclass(frozen=True)
class Answer:
    """What a tool returned: a diagnosis (None: failed), a prediction (empty: failed; None: not requested)."""

    diagnosis: object
    predicted_um: Array | None
    diagnose_s: float
    failure: str = ""


def ask(entry: Entry, given: Path, out: Path) -> Answer:
    """Run the commands on the recordings in `given`, with a prediction if there is a held-out input."""
    out.mkdir(parents=True, exist_ok=True)
    words = {
        "python": shlex.quote(sys.executable),
        "recordings": " ".join(shlex.quote(str(p)) for p in sorted(given.glob("?.csv"))),
        "out": shlex.quote(str(out)),
        "input": shlex.quote(str(given / "heldout_input.csv")),
        "prediction": shlex.quote(str(out / "prediction.csv")),
    }
    started = time.perf_counter()
    failure = _run(entry.diagnose.format(**words), entry.timeout_s)
    seconds = time.perf_counter() - started
    diagnosis = None
    if not failure:
        try:
            diagnosis = json.loads((out / "diagnosis.json").read_text())
        except (OSError, ValueError) as error:
            failure = f"diagnosis.json: {error}"
    predicted = None
    if entry.predict and (given / "heldout_input.csv").exists():
        failure = failure or _run(entry.predict.format(**words), entry.timeout_s)
        try:
            predicted = np.zeros(0) if failure else read_column(out / "prediction.csv", "output_um")
        except (OSError, ValueError) as error:
            predicted, failure = np.zeros(0), f"prediction.csv: {error}"
    return Answer(diagnosis, predicted, seconds, failure)


def _run(command: str, timeout_s: float) -> str:
    """Return why the command failed, or ''. After the timeout it is killed with all that it started."""
    package = str(Path(__file__).parents[1])
    paths = os.pathsep.join(p for p in (package, os.environ.get("PYTHONPATH", "")) if p)
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": paths}
    try:
        process = subprocess.Popen(
            shlex.split(command),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
            start_new_session=True,
        )
    except OSError as error:
        return f"{shlex.split(command)[0]}: {error.strerror}"
    try:
        _, errors = process.communicate(timeout=timeout_s)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, 9)
        process.communicate()
        return f"no answer in {timeout_s:g} s"
    return "" if process.returncode == 0 else f"exit {process.returncode}: {errors[-2000:]}"
