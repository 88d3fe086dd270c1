"""Run a diagnosis tool on real recordings with and without a known effect in them, and grade its answers.

    python benchmarks/real/score.py recordings/real --answers recordings/answers/real --processes 2

Answers that stand in ANSWERS already are kept, so a run that was cut off goes on; `--read-only` grades what
is there. Writes ANSWERS/results.json and results.md.
"""

import argparse
import json
from pathlib import Path

from injection.grade import Grade, grade
from injection.summary import summarise, table
from judging.answers import DIAGNOSE, Commands, answer_folder, collect


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cases", type=Path, nargs="+", help="folders that inject.py wrote, one a seed")
    parser.add_argument("--answers", type=Path, required=True)
    parser.add_argument("--diagnose", default=DIAGNOSE, help="command template")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--timeout-s", type=float, default=600.0)
    parser.add_argument("--limit", type=int, help="only the first so many cases")
    parser.add_argument("--kinds", nargs="*", help="only cases with these kinds of effect")
    parser.add_argument("--sources", nargs="*", help="only cases on these recordings")
    parser.add_argument(
        "--read-only", action="store_true", help="run nothing, grade the answers that are there"
    )
    options = parser.parse_args()
    cases = [
        case
        for folder in options.cases
        for case in sorted(folder.glob("case_*"))
        if not options.kinds or sealed(case)["kind"] in options.kinds
        if not options.sources or sealed(case)["source"] in options.sources
    ][: options.limit]
    untouched = sorted({untouched_of(case) for case in cases})
    if not options.read_only:
        commands = Commands(options.diagnose, "", options.timeout_s)
        collect(untouched + cases, options.answers, commands, options.processes)
    answers = {
        str(folder): read_answer(options.answers, folder)
        for folder in untouched
        if answered(options.answers, folder)
    }
    grades = [
        score_case(case, options.answers, answers[str(untouched_of(case))])
        for case in cases
        if answered(options.answers, case) and str(untouched_of(case)) in answers
    ]
    summary = summarise(
        grades, {f"{u.parent.name}/{u.name}": answers[str(u)] for u in untouched if str(u) in answers}
    )
    results = {**summary, "cases": [g.as_dict() for g in grades]}
    options.answers.mkdir(parents=True, exist_ok=True)
    (options.answers / "results.json").write_text(json.dumps(results, indent=1) + "\n")
    (options.answers / "results.md").write_text(table(summary))
    print(table(summary))
    for g in grades:
        if g.wrong or g.outcome in ("missed", "overlooked"):
            severity = "" if g.severity is None else f" {g.severity:.1f}×"
            named = ", ".join(g.named) or "no name"
            print(
                f"{g.case} {g.source} {g.kind}{severity}: {g.outcome}; {named}; wrong {g.wrong}; {g.verdict}"
            )


def sealed(case: Path) -> dict:
    """The labels of a case."""
    return json.loads((case.parent / "sealed" / f"{case.name}.json").read_text())


def untouched_of(case: Path) -> Path:
    """The folder of the same recordings without the effect."""
    return case.parent / sealed(case)["untouched"]


def answered(answers: Path, case: Path) -> bool:
    """Whether the tool answered or failed."""
    folder = answer_folder(answers, case)
    return (folder / "diagnosis.json").exists() or (folder / "failed.txt").exists()


def read_answer(answers: Path, case: Path) -> dict | None:
    """The diagnosis of these recordings; None where the tool failed."""
    folder = answer_folder(answers, case)
    if (folder / "failed.txt").exists():
        return None
    return json.loads((folder / "diagnosis.json").read_text())


def score_case(case: Path, answers: Path, untouched: dict | None) -> Grade:
    """The grade of one case that has been answered."""
    run = answer_folder(answers, case) / "run.json"
    seconds = json.loads(run.read_text()).get("diagnose_s") if run.exists() else None
    return grade(sealed(case), read_answer(answers, case), untouched, diagnose_s=seconds)


if __name__ == "__main__":
    main()
