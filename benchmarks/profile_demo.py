"""Show where the time of `make demo` goes, phase by phase.

    python benchmarks/profile_demo.py [--cold]

Runs the demo's three commands, each in a process of its own, on one core, in a temporary folder. A phase is
the processor time spent in certain functions, excluding the phases that they call. `--cold` begins without
compiled kernels, as a fresh checkout does.
"""

import argparse
import functools
import importlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from torchpi.cli.workers import end_with_parent

PHASES = {
    "fit": {
        "simulating the recordings": "train.simulation:simulate",
        "two stages, look-ahead": "train.module:InverseTraining.build",
        "training": "lightning.pytorch.trainer.trainer:Trainer.fit",
        "figures in TensorBoard": "train.callbacks:TensorBoardFigures.draw",
        "checkpoints": "train.trainer:WholeCheckpoints.save_checkpoint",
        "judging, files to deploy": "train.results:write_results",
        "page with its figures": "torchpi.report.page:write_training_report",
        "kernels, compiled or loaded": "numba.core.dispatcher:Dispatcher._compile_for_args",
    },
    "export": {"writing and checking the files": "torchpi.export:export_files"},
    "run": {
        "loop, sample by sample": "torchpi.loop.loop:run_loop",
        "page with its figures": "torchpi.report:write_loop_report",
    },
}
PROGRAMS = {"fit": "train.cli", "export": "torchpi.cli.commands", "run": "torchpi.cli.commands"}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cold", action="store_true", help="begin with no compiled kernels")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        spent = profiled(Path(folder), options.cold)
    every = sum(sum(phases.values()) for phases in spent.values())
    print("| command | phase | s | share |\n|---|---|---:|---:|")
    for name, phases in spent.items():
        for phase, seconds in sorted(phases.items(), key=lambda item: -item[1]):
            print(f"| {name} | {phase} | {seconds:.2f} | {100 * seconds / every:.0f} % |")
    print(f"| | all | {every:.2f} | |")


def profiled(folder: Path, cold: bool = False) -> dict[str, dict[str, float]]:
    """Run the demo into a folder, which keeps its files.

    Args:
        folder: Receives the run, the exported files, and the loop in `demo/`.
        cold: Whether to begin with no compiled kernels.

    Returns:
        Processor seconds by command and phase.
    """
    run, model = f"{folder}/run", f"{folder}/demo"
    commands = {
        "fit": ["fit", "--config", "configs/demo.yaml", "--output", run],
        "export": ["export", run, "--output", model],
        "run": ["run", f"{model}.pt", "--stage", "configs/stage/default.yaml",
                "--trajectory", "[slow, fast]", "--compare", f"{{two-stage: {run}/baseline.pt}}"],
    }  # fmt: skip
    one_core = dict(OMP_NUM_THREADS="1")
    if cold:
        one_core["NUMBA_CACHE_DIR"] = f"{folder}/kernels"
    spent = {}
    for name, arguments in commands.items():
        report = folder / f"{name}.json"
        subprocess.run(
            [sys.executable, __file__, "--of", str(os.getpid()), name, str(report), *arguments],
            env=os.environ | one_core, stdout=subprocess.DEVNULL, check=True,
        )  # fmt: skip
        spent[name] = json.loads(report.read_text(encoding="utf-8"))
    return spent


def profile(command: str, report: Path, arguments: list[str]) -> None:
    """Run one command in this process, and write the processor seconds of its phases."""
    clock = Clock()
    program = importlib.import_module(PROGRAMS[command])
    for phase, function in PHASES[command].items():
        module, _, path = function.partition(":")
        _wrap(importlib.import_module(module), path, functools.partial(clock.timed, phase))
    clock.spent["starting Python, imports"] = time.process_time()
    sys.argv[1:] = arguments
    try:
        clock.timed("the rest", program.main)()
    except SystemExit as ended:
        if ended.code:
            raise
    report.write_text(json.dumps(clock.spent), encoding="utf-8")


def _wrap(owner: Any, path: str, timed: Callable[[Callable[..., Any]], Callable[..., Any]]) -> None:
    *outer, name = path.split(".")
    for part in outer:
        owner = getattr(owner, part)
    original = getattr(owner, name)
    wrapped = timed(original)
    setattr(owner, name, wrapped)
    # Replace it also in the modules that imported it by name.
    for module in list(sys.modules.values()):
        if vars(module).get(name) is original:
            setattr(module, name, wrapped)


class Clock:
    """Processor seconds of each phase, excluding the phases nested in it."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}
        self.within = [0.0]

    def timed(self, phase: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def run(*arguments: Any, **options: Any) -> Any:
            self.within.append(0.0)
            start = time.process_time()
            try:
                return function(*arguments, **options)
            finally:
                whole = time.process_time() - start
                self.spent[phase] = self.spent.get(phase, 0.0) + whole - self.within.pop()
                self.within[-1] += whole

        return run


if __name__ == "__main__":
    if sys.argv[1:2] == ["--of"]:
        end_with_parent(int(sys.argv[2]))
        profile(sys.argv[3], Path(sys.argv[4]), sys.argv[5:])
    else:
        main()
