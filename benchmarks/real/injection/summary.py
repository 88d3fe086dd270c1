"""Grades added up, and shown as Markdown."""

from collections.abc import Sequence

import numpy as np
from judging.proportions import share

from injection.grade import Grade

FIGURES = (
    ("right_group", "right group"),
    ("exact", "exact name"),
    ("named_before", "named without the injection, not counted"),
    ("wrong_names", "wrong, of all names that are new"),
    ("cases_with_a_wrong_name", "cases with a wrong name"),
    ("recognised", "without a name: recognised as unexplained"),
    ("failed", "no answer"),
)
BOUNDED = ("right_group", "exact", "recognised")  # better the more there are


def summarise(grades: Sequence[Grade], untouched: dict[str, dict | None]) -> dict[str, object]:
    """Figures over all cases, by kind of effect, by source and by severity; and the untouched answers."""
    return {
        "all": figures(grades),
        "by_kind": {k: figures([g for g in grades if g.kind == k]) for k in sorted({g.kind for g in grades})},
        "by_source": {
            s: figures([g for g in grades if g.source == s]) for s in sorted({g.source for g in grades})
        },
        "by_severity": {
            f"{low:g}-{high:g}": figures([g for g in grades if low <= (g.severity or 0) < high])
            for low, high in ((1.5, 5.0), (5.0, 10.0), (10.0, 20.0), (20.0, 60.0))
        },
        "by_severity_over_residual": {
            f"{low:g}-{high:g}": figures([g for g in grades if low <= (g.severity_over_residual or 0) < high])
            for low, high in ((0.0, 0.5), (0.5, 1.0), (1.0, 2.0), (2.0, 5.0), (5.0, np.inf))
            if any(g.severity_over_residual for g in grades)
        },
        "parameters": _parameters(grades),
        "untouched": {name: _answer(answer) for name, answer in sorted(untouched.items())},
    }


def figures(grades: Sequence[Grade]) -> dict[str, object]:
    """Counts with bounds. An effect that is named without the injection and did not grow is in no share."""
    right = sum(g.outcome == "right" for g in grades)
    counted = right + sum(g.outcome == "missed" for g in grades)
    nameless = [g for g in grades if g.outcome in ("recognised", "overlooked")]
    wrong = sum(len(g.wrong) for g in grades)
    return {
        "cases": len(grades),
        "right_group": share(right, counted),
        "exact": share(sum(g.exact for g in grades), counted),
        "named_before": sum(g.outcome == "named_before" for g in grades),
        "wrong_names": share(wrong, right + wrong),
        "cases_with_a_wrong_name": share(sum(bool(g.wrong) for g in grades), len(grades)),
        "recognised": share(sum(g.outcome == "recognised" for g in nameless), len(nameless)),
        "failed": sum(g.verdict == "failed" for g in grades),
        "diagnose_s_median": _median([g.diagnose_s for g in grades if g.diagnose_s is not None]),
    }


def _parameters(grades: Sequence[Grade]) -> dict[str, object]:
    rows = [p for g in grades for p in g.parameters]
    covered = [p["covered"] for p in rows if p.get("covered") is not None]
    return {
        "relative_error_median": _median([p["relative_error"] for p in rows if "relative_error" in p]),
        "interval_coverage": share(sum(covered), len(covered)),
    }


def _median(values: list[float]) -> float | None:
    return float(np.median(values)) if values else None


def _answer(answer: dict | None) -> dict[str, object]:
    if answer is None:
        return {"verdict": "failed", "effects": []}
    kept = ("name", "alternatives", "probability", "share", "form")
    effects = [{k: e[k] for k in kept if k in e} for e in answer.get("effects", [])]
    return {"verdict": answer.get("verdict"), "fit": answer.get("fit"), "effects": effects}


def table(summary: dict) -> str:
    """What was found over all cases, then by kind, source and severity, then the untouched answers."""
    lines = [
        "| | all cases | one-sided 95 % bound |",
        "|---|---|---|",
        f"| cases | {summary['all']['cases']} | |",
    ]
    for key, words in FIGURES:
        value = summary["all"][key]
        if isinstance(value, int):
            lines.append(f"| {words} | {value} | |")
        elif value["of"]:
            bound = (
                f"at least {100 * value['at_least']:.0f} %"
                if key in BOUNDED
                else f"at most {100 * value['at_most']:.0f} %"
            )
            lines.append(f"| {words} | {_cell(value)} | {bound} |")
    parameters = summary["parameters"]
    if parameters["relative_error_median"] is not None:
        lines.append(f"| parameters, median relative error | {parameters['relative_error_median']:.2g} | |")
        lines.append(f"| 90 % intervals cover | {_cell(parameters['interval_coverage'])} | |")
    for key, words in (
        ("by_kind", "effect"),
        ("by_source", "recording"),
        ("by_severity", "severity, × noise"),
        ("by_severity_over_residual", "severity, × what the untouched answer leaves"),
    ):
        lines += [
            "",
            f"| {words} | cases | right group | named before | wrong names | recognised | s |",
            "|---|---|---|---|---|---|---|",
        ]
        for name, row in summary[key].items():
            if row["cases"]:
                seconds = row["diagnose_s_median"]
                cells = [_cell(row["right_group"]), str(row["named_before"]), _cell(row["wrong_names"])]
                cells += [_cell(row["recognised"]), "–" if seconds is None else f"{seconds:.0f}"]
                lines.append(f"| {name} | {row['cases']} | {' | '.join(cells)} |")
    lines += ["", "| untouched | verdict | names (probability; alternatives) |", "|---|---|---|"]
    for name, answer in summary["untouched"].items():
        lines.append(f"| {name} | {answer['verdict']} | {', '.join(map(_named, answer['effects'])) or '–'} |")
    return "\n".join(lines) + "\n"


def _named(effect: dict) -> str:
    probability = effect.get("probability")
    inside = [] if probability is None else [f"{probability:.2f}"]
    inside += [" or ".join(effect["alternatives"])] if effect.get("alternatives") else []
    return f"{effect['name']} ({'; '.join(inside)})"


def _cell(value: dict) -> str:
    return f"{100 * value['share']:.0f} % ({value['count']}/{value['of']})" if value["of"] else "–"
