"""Grades added up: the figures of the specification, one confusion matrix, detection against severity."""

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
from plant.effects import EFFECTS, GROUPS

from judging.grade import Grade
from judging.proportions import share

BINS = (0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0, float("inf"))
SINGLE = ("single_pi", "single_other", "crime")


def summarise(grades: Sequence[Grade]) -> dict[str, object]:
    """Every figure by track; `confusion` and `detection` over all tracks with at most one effect.

    `together` is precision and false alarms over all tracks but `crime`.
    """
    tracks = sorted({g.track for g in grades})
    proof = [g for g in grades if g.track != "crime"]
    nulls = [g for g in proof if not g.truth and not g.unknown]
    right, wrong = sum(len(g.found) for g in proof), sum(len(g.wrong) for g in proof)
    return {
        "tracks": {track: _track([g for g in grades if g.track == track]) for track in tracks},
        "together": {
            "precision": share(right, right + wrong),
            "false_alarms": share(sum(bool(g.wrong) for g in nulls), len(nulls)),
        },
        "confusion": _confusion(grades),
        "detection": _detection([g for g in grades if g.track in ("single_pi", "single_other")]),
    }


def _track(grades: list[Grade]) -> dict[str, object]:
    truths = [(g, name, g.severities[name]) for g in grades for name in g.truth]
    clear = [(g, name) for g, name, s in truths if s >= 2]
    faint = [(g, name) for g, name, s in truths if 0.7 <= s < 2]
    separable = [(g, name) for g, name in clear if not any(name in group for group in GROUPS)]
    right, wrong = sum(len(g.found) for g in grades), sum(len(g.wrong) for g in grades)
    out: dict[str, object] = {
        "cases": len(grades),
        "failed": sum(g.failed for g in grades),
        "precision": share(right, right + wrong),
        "cases_with_a_wrong_name": share(sum(bool(g.wrong) for g in grades), len(grades)),
        "group_at_2": share(sum(name in g.found for g, name in clear), len(clear)),
        "group_at_1": share(sum(name in g.found for g, name in faint), len(faint)),
        "exact_where_separable": share(sum(name in g.exact for g, name in separable), len(separable)),
        "exact_sets": share(
            sum(_exact_set(g) for g in grades if g.truth), sum(bool(g.truth) for g in grades)
        ),
        "f1": _mean(_f1(g) for g in grades if g.truth),
        "diagnose_s_median": _median(g.diagnose_s for g in grades),
        "heldout_over_noise_median_explained": _median(g.heldout_over_noise for g in grades if _explained(g)),
        "heldout_over_noise_median": _median(g.heldout_over_noise for g in grades),
    }
    closed = [g.heldout_over_noise for g in grades if g.verdict in ("explained", "nothing_missing")]
    predicted = [ratio for ratio in closed if ratio is not None]
    out["closed_beyond_twice_the_noise"] = share(sum(ratio > 2 for ratio in predicted), len(predicted))
    unknown = [g for g in grades if g.unknown]
    if unknown:
        out["unknown_without_a_wrong_name"] = share(sum(not g.wrong for g in unknown), len(unknown))
        out["unknown_recognised"] = share(
            sum(_answer_without_name(g) == "unknown" for g in unknown), len(unknown)
        )
        out["unknown_heldout_improves"] = share(
            sum(g.heldout_gain is not None and g.heldout_gain > 0.005 for g in unknown), len(unknown)
        )
    compared = [p for g in grades for p in g.parameters if p["severity"] >= 2]
    errors = [p["relative_error"] for p in compared if "relative_error" in p]
    covered = [p["covered"] for p in compared if p.get("covered") is not None]
    out["parameters_compared"] = share(len(errors), len(compared))
    out["parameter_error_median"] = _median(errors)
    out["interval_coverage"] = share(sum(covered), len(covered))
    return out


def _mean(values: Iterable[float]) -> float | None:
    values = list(values)
    return float(np.mean(values)) if values else None


def _median(values: Iterable[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return float(np.median(known)) if known else None


def _exact_set(g: Grade) -> bool:
    return not g.failed and len(g.found) == len(g.truth) and not g.wrong


def _explained(g: Grade) -> bool:
    return _exact_set(g) and not g.unknown


def _f1(g: Grade) -> float:
    return 2 * len(g.found) / (2 * len(g.found) + len(g.wrong) + len(g.truth) - len(g.found))


def _answer_without_name(g: Grade) -> str:
    if g.failed:
        return "failed"
    if g.wrong:
        return g.wrong[0]
    return "unknown" if g.verdict in ("unexplained", "partly_explained") else "nothing"


def _answer(g: Grade) -> str:
    if g.found:
        truth = g.found[0]
        if truth in g.exact:
            return truth
        return next((n for n in g.named if n not in g.wrong + g.tolerated), truth)
    return _answer_without_name(g)


def _confusion(grades: Sequence[Grade]) -> dict[str, object]:
    rows = [*EFFECTS, "nothing", "unknown"]
    columns = [*rows, "failed"]
    matrix = np.zeros((len(rows), len(columns)), dtype=int)
    for g in grades:
        if len(g.truth) + len(g.unknown) > 1 or g.track == "crime":
            continue
        truth = "unknown" if g.unknown else g.truth[0] if g.truth else "nothing"
        answer = _answer(g)
        if answer not in columns:
            answer = "unknown"
        matrix[rows.index(truth), columns.index(answer)] += 1
    return {"truth": rows, "answer": columns, "matrix": matrix.tolist()}


def _detection(grades: Sequence[Grade]) -> list[dict[str, object]]:
    out = []
    for measure in ("severity", "severity_beyond_plays"):
        for low, high in pairwise(BINS):
            inside = [g for g in grades if low <= _size(g, measure) < high]
            out.append(
                {
                    "measure": measure,
                    "from": low,
                    "to": None if high == float("inf") else high,
                    "cases": len(inside),
                    "right_group": sum(bool(g.found) for g in inside),
                    "wrong": sum(bool(g.wrong) for g in inside),
                }
            )
    return out


def _size(g: Grade, measure: str) -> float:
    return next(iter((g.severities if measure == "severity" else g.beyond_plays).values()))
