"""Check the diagnoses that the README's own commands give, for all subsets of its recordings.

    python benchmarks/readme_check.py [--keep answers]

Runs the README's `torchpi simulate` lines in a temporary folder, and its `torchpi diagnose` line for every
subset of these recordings. The built-in stage has a mode, creep, a lag and a delay, so no subset may yield
"nothing is missing", and all recordings together must name the mode, creep, and a lag or a delay. Prints each
verdict with its names, and exits with 1 if one of these conditions is violated.
"""

import argparse
import json
import re
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

README = Path(__file__).parents[1] / "README.md"
# With all recordings, one effect of each set must be named or be an alternative to a name.
REQUIRED = (
    frozenset({"resonance", "second_mode"}),
    frozenset({"creep"}),
    frozenset({"amplifier_lag", "sensor_lag", "delay"}),
)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--torchpi", default="torchpi", help="the program")
    parser.add_argument("--keep", type=Path, help="folder in which recordings and answers are left")
    parser.add_argument("--sizes", type=int, nargs="*", default=[1, 2, 3, 4], help="of the subsets")
    options = parser.parse_args()
    simulate, diagnose = readme_lines(README.read_text(encoding="utf-8"))
    program = shlex.split(options.torchpi)
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for words in simulate:
            run([*program, *words], folder)
        recordings = [words[words.index("--output") + 1] for words in simulate]
        complaints = []
        for size in options.sizes:
            for subset in combinations(recordings, size):
                answer = "diagnosis_" + "_".join(Path(name).stem for name in subset)
                started = time.perf_counter()
                run([*program, *with_recordings(diagnose, subset, answer)], folder)
                seconds = time.perf_counter() - started
                diagnosis = json.loads((folder / answer / "diagnosis.json").read_text())
                print(
                    f"{' '.join(Path(n).stem for n in subset)}: {line(diagnosis)}; {seconds:.0f} s",
                    flush=True,
                )
                complaints += [
                    f"{' '.join(subset)}: {text}"
                    for text in faults(diagnosis, len(subset) == len(recordings))
                ]
    for complaint in complaints:
        print(complaint, file=sys.stderr)
    return 1 if complaints else 0


def run(command: Sequence[str], folder: Path) -> None:
    """Run a command in the folder; if it fails, end the check with its error output."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{shlex.join(command)}: exit {done.returncode}: {done.stderr.strip()[-500:]}")


def readme_lines(readme: str) -> tuple[list[list[str]], list[str]]:
    """The words of each `torchpi simulate` line and of the `torchpi diagnose` line, without `torchpi`."""
    blocks = re.findall(r"```sh\n(.*?)```", readme, re.DOTALL)
    commands = [shlex.split(text) for block in blocks for text in block.splitlines()]
    verbs = {
        verb: [c[1:] for c in commands if c[:2] == ["torchpi", verb]] for verb in ("simulate", "diagnose")
    }
    if not verbs["simulate"] or len(verbs["diagnose"]) != 1:
        found = ", ".join(f"{len(lines)} of {verb}" for verb, lines in verbs.items())
        raise ValueError(f"README.md: found {found}, expected simulate lines and one diagnose line")
    return verbs["simulate"], verbs["diagnose"][0]


def with_recordings(diagnose: Sequence[str], recordings: Sequence[str], output: str) -> list[str]:
    """The diagnose line for these recordings and this output folder; its other options are kept."""
    words = [word for word in diagnose if not word.endswith(".csv")]
    words[words.index("--output") + 1] = output
    return [words[0], *recordings, *words[1:]]


def line(diagnosis: dict) -> str:
    """The verdict and the names with their probabilities."""
    names = [
        f"{e['name']} {e['probability']:.2f}"
        + f" (or {', '.join(e['alternatives'])})" * bool(e["alternatives"])
        for e in diagnosis["effects"]
    ]
    return f"{diagnosis['verdict']}: {'; '.join(names) or 'no name'}"


def faults(diagnosis: dict, complete: bool) -> list[str]:
    """Faults of an answer; `complete`: it was given all recordings, so it must have the required names."""
    out = []
    if diagnosis["verdict"] == "nothing_missing":
        out.append("found verdict nothing_missing, expected another, since physics is missing")
    named = {name for e in diagnosis["effects"] for name in (e["name"], *e["alternatives"])}
    if complete:
        found = ", ".join(sorted(named)) or "no name"
        out += [f"found {found}, expected {' or '.join(sorted(r))}" for r in REQUIRED if not r & named]
    return out


if __name__ == "__main__":
    sys.exit(main())
