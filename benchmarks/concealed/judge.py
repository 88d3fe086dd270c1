"""Run a diagnosis tool on concealed cases, open the seals, grade its answers.

    python benchmarks/concealed/judge.py recordings/single_pi recordings/nulls_other \\
        --answers recordings/answers/torchpi --processes 2

Answers that stand in ANSWERS/TRACK/CASE already are kept, so a run that was cut off goes on; `--read-only`
grades what is there. Writes ANSWERS/results.json, results.md and results.png.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from judging.answers import DIAGNOSE, PREDICT, Commands, answer_folder, collect
from judging.grade import Grade, grade
from judging.summary import summarise
from judging.tables import table


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cases", type=Path, nargs="+", help="folders that generate.py wrote, one a track")
    parser.add_argument("--answers", type=Path, required=True)
    parser.add_argument("--diagnose", default=DIAGNOSE, help="command template")
    parser.add_argument("--predict", default=PREDICT, help="command template; empty for none")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--timeout-s", type=float, default=600.0)
    parser.add_argument("--limit", type=int, help="only the first so many cases of each folder")
    parser.add_argument(
        "--read-only", action="store_true", help="run nothing, grade the answers that are there"
    )
    parser.add_argument("--no-figure", action="store_true")
    options = parser.parse_args()
    cases = [case for folder in options.cases for case in sorted(folder.glob("case_*"))[: options.limit]]
    if not options.read_only:
        commands = Commands(options.diagnose, options.predict, options.timeout_s)
        collect(cases, options.answers, commands, options.processes)
    grades = [g for g in (judge_case(case, answer_folder(options.answers, case)) for case in cases) if g]
    summary = summarise(grades)
    results = {**summary, "cases": [g.as_dict() for g in grades]}
    (options.answers / "results.json").write_text(json.dumps(results, indent=1) + "\n")
    (options.answers / "results.md").write_text(table(summary))
    if not options.no_figure:
        from judging.figures import draw

        draw(summary, options.answers / "results.png")
    print(table(summary))
    for g in grades:
        if g.wrong or g.failed or any(g.severities[name] >= 2 for name in set(g.truth) - set(g.found)):
            truth = ", ".join(f"{name} {s:.1f}×" for name, s in g.severities.items()) or "nothing"
            print(f"{g.track}/{g.case} ({g.family}): {truth}; said {', '.join(g.named) or g.verdict}")


def judge_case(case: Path, answer: Path) -> Grade | None:
    """The grade of one case, or None while it has no answer."""
    labels = json.loads((case.parent / "sealed" / f"{case.name}.json").read_text())
    if (answer / "failed.txt").exists():
        return grade(labels, None)
    if not (answer / "diagnosis.json").exists():
        return None
    run = answer / "run.json"
    predicted = measured = None
    if (answer / "prediction.csv").exists():
        predicted = _column(answer / "prediction.csv", "output_um")
        measured = _column(case.parent / "sealed" / f"{case.name}_heldout.csv", "output_um")
    return grade(
        labels,
        json.loads((answer / "diagnosis.json").read_text()),
        predicted_um=predicted,
        measured_um=measured,
        diagnose_s=json.loads(run.read_text()).get("diagnose_s") if run.exists() else None,
    )


def _column(path: Path, name: str) -> np.ndarray:
    with path.open() as file:
        index = file.readline().strip().split(",").index(name)
    return np.loadtxt(path, delimiter=",", skiprows=1, usecols=index)


if __name__ == "__main__":
    main()
