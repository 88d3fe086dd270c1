"""Get a tool's answers: run its two commands on every case that has no answer yet."""

import json
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

DIAGNOSE = "torchpi diagnose {recordings} --output {out}"
PREDICT = "torchpi predict {out}/stage.pt {input} --output {prediction}"


@dataclass(frozen=True)
class Commands:
    """Templates with {recordings}, {out}, {input}, {prediction}; an empty `predict` is skipped."""

    diagnose: str = DIAGNOSE
    predict: str = PREDICT
    timeout_s: float = 600.0


def collect(cases: Sequence[Path], answers: Path, commands: Commands, processes: int) -> None:
    """Answer every case into ANSWERS/TRACK/CASE, `processes` at a time; what is answered already stays.

    A command that fails leaves `failed.txt` with what it said; deleting that file tries again.
    """
    missing = [case for case in cases if not _answered(answer_folder(answers, case))]
    with ThreadPoolExecutor(processes) as pool:
        for done, line in enumerate(pool.map(lambda case: _answer(case, answers, commands), missing), 1):
            print(f"{done}/{len(missing)} {line}", file=sys.stderr, flush=True)


def answer_folder(answers: Path, case: Path) -> Path:
    """Where the answer to CASES/TRACK/case_0001 stands."""
    return answers / case.parent.name / case.name


def _answered(folder: Path) -> bool:
    return (folder / "run.json").exists() or (folder / "failed.txt").exists()


def _answer(case: Path, answers: Path, commands: Commands) -> str:
    folder = answer_folder(answers, case)
    folder.mkdir(parents=True, exist_ok=True)
    words = {
        "recordings": " ".join(shlex.quote(str(p)) for p in sorted(case.glob("?.csv"))),
        "out": shlex.quote(str(folder)),
        "input": shlex.quote(str(case / "heldout_input.csv")),
        "prediction": shlex.quote(str(folder / "prediction.csv")),
    }
    seconds = {}
    for verb, template in (("diagnose", commands.diagnose), ("predict", commands.predict)):
        if not template:
            continue
        started = time.perf_counter()
        failure = _run(shlex.split(template.format(**words)), commands.timeout_s)
        seconds[f"{verb}_s"] = time.perf_counter() - started
        if failure:
            (folder / "failed.txt").write_text(f"{verb}: {failure}\n")
            return f"{case.parent.name}/{case.name}: {verb} failed"
    (folder / "run.json").write_text(json.dumps(seconds))
    return f"{case.parent.name}/{case.name}: {seconds['diagnose_s']:.1f} s"


def _run(arguments: list[str], timeout_s: float) -> str:
    one_thread = os.environ | {"OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(arguments, capture_output=True, text=True, timeout=timeout_s, env=one_thread)
    except subprocess.TimeoutExpired:
        return f"no answer in {timeout_s:g} s"
    return "" if done.returncode == 0 else f"exit {done.returncode}: {done.stderr[-2000:]}"
