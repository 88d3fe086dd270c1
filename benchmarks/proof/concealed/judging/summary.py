"""Summary of the grades: every figure with its count and its one-sided 95 % bound."""

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise

import numpy as np
from concealed.judging.calibration import calibration
from concealed.judging.grade import Grade
from concealed.judging.proportions import share
from concealed.names import GROUPS, NAMES

CLEAR, FAINT, CLEAR_OF_RESIDUAL = 2.0, 0.7, 3.0
"""Severities, in units of the noise or, for the last, of the residual of the untouched recording's answer."""
CLOSE, FAR = 1.5, 2.0  # held-out residual over noise
GAIN = 0.005  # reduction of the held-out error that counts as an improvement
BINS = (0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0, float("inf"))
STILL_OPEN = ("unexplained", "partly_explained")
CLOSED = ("explained", "nothing_missing")

Grades = Sequence[Grade]
Share = dict[str, float | int | None]


def truths(grades: Grades, low: float = CLEAR, high: float = float("inf")) -> list[tuple[Grade, str]]:
    """Return each listed truth of a severity in [low, high) that the excitation could show."""
    return [
        (g, name)
        for g in grades
        for name in g.truth
        if g.adequate and not g.named_before and low <= g.severities[name] < high
    ]


def _found(pairs: Sequence[tuple[Grade, str]], attribute: str = "found") -> Share:
    return share(sum(name in getattr(g, attribute) for g, name in pairs), len(pairs))


def _cases(grades: Iterable[Grade], test: Callable[[Grade], bool]) -> Share:
    asked = list(grades)
    return share(sum(map(test, asked)), len(asked))


def _separable(pairs: Sequence[tuple[Grade, str]]) -> list[tuple[Grade, str]]:
    return [(g, name) for g, name in pairs if not any(name in group for group in GROUPS)]


def _several(grades: Grades, count: int) -> list[Grade]:
    return [g for g in grades if len(g.truth) == count]


def exact_set(g: Grade) -> bool:
    """Whether every truth is found, and nothing wrong is named."""
    return len(g.found) == len(g.truth) and not g.wrong


def recognised(g: Grade) -> bool:
    """Whether an effect outside the list is left open, and nothing wrong is named."""
    return not g.wrong and g.verdict in STILL_OPEN


def improves(g: Grade) -> bool:
    """Whether the augmented stage predicts better than the retuned one, by the tool's own account."""
    return g.heldout_gain is not None and g.heldout_gain > GAIN


def _f1(g: Grade) -> float:
    return 2 * len(g.found) / (2 * len(g.found) + len(g.wrong) + len(g.truth) - len(g.found))


def _precision(grades: Grades) -> Share:
    counted = [g for g in grades if not g.named_before]
    right, wrong = sum(len(g.found) for g in counted), sum(len(g.wrong) for g in counted)
    return share(right, right + wrong)


def _ratios(grades: Grades, verdicts: Sequence[str]) -> list[float]:
    return [
        g.heldout_over_noise for g in grades if g.heldout_over_noise is not None and g.verdict in verdicts
    ]


def _intervals(grades: Grades) -> Share:
    rows = [
        p for g in grades for p in g.parameters if p["severity"] >= CLEAR and p.get("covered") is not None
    ]
    return share(sum(bool(p["covered"]) for p in rows), len(rows))


def _errors(grades: Grades) -> list[float]:
    return [
        p["relative_error"]
        for g in grades
        for p in g.parameters
        if p["severity"] >= CLEAR and "relative_error" in p
    ]


def _median(values: Iterable[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return float(np.median(known)) if known else None


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _calibration_error(grades: Grades) -> float | None:
    return calibration([g.as_dict() for g in grades])["as_a_group"]["expected_calibration_error"]


def _unknown(grades: Grades) -> list[Grade]:
    return [g for g in grades if g.unknown]


def _ratio_share(ratios: Sequence[float], test: Callable[[float], bool]) -> Share:
    return share(sum(map(test, ratios)), len(ratios))


# Key, words, function of the grades, and whether more is better, which decides the bound that is quoted.
FIGURES: tuple[tuple[str, str, Callable[[Grades], Share | float | int | None], bool], ...] = (
    ("cases", "cases", len, True),
    ("failed", "no answer that can be graded", lambda g: _cases(g, lambda c: bool(c.failed)), False),
    (
        "false_alarms",
        "nothing missing, yet something wrong is named",
        # A tool that gave no answer cannot be credited with silence.
        lambda g: _cases([c for c in g if c.null and not c.failed], lambda c: bool(c.wrong)),
        False,
    ),
    ("precision", "precision when it names", _precision, True),
    ("group", "right group, 2 × the noise and more", lambda g: _found(truths(g)), True),
    ("group_faint", "right group, 0.7 to 2 ×", lambda g: _found(truths(g, FAINT, CLEAR)), True),
    ("exact", "exact name where separable", lambda g: _found(_separable(truths(g)), "exact"), True),
    (
        "foreign",
        "right cause in a form that the library lacks",
        lambda g: _found([(c, name) for c, name in truths(g) if name in c.foreign]),
        True,
    ),
    (
        "foreign_wrong",
        "cases with a foreign form and a wrong name",
        lambda g: _cases([c for c in g if c.foreign], lambda c: bool(c.wrong)),
        False,
    ),
    (
        "unknown",
        "outside the list: left open, nothing wrong named",
        lambda g: _cases(_unknown(g), recognised),
        True,
    ),
    (
        "unknown_right",
        "outside the list: nothing wrong named",
        lambda g: _cases(_unknown(g), lambda c: not c.wrong and not c.failed),
        True,
    ),
    (
        "unknown_improves",
        "outside the list, determined by u: held-out fit improves",
        lambda g: _cases([c for c in _unknown(g) if c.foreseeable], improves),
        True,
    ),
    ("pairs", "two at once: exact set", lambda g: _cases(_several(g, 2), exact_set), True),
    ("triples_f1", "three at once: mean F1", lambda g: _mean([_f1(c) for c in _several(g, 3)]), True),
    ("calibration_error", "expected calibration error", _calibration_error, False),
    ("intervals", "90 % intervals cover", _intervals, True),
    ("parameter_error", "parameters: median relative error", lambda g: _median(_errors(g)), False),
    (
        "heldout",
        "held-out residual over noise, explained: median",
        lambda g: _median(_ratios(g, CLOSED)),
        False,
    ),
    (
        "heldout_close",
        "held-out residual at most 1.5 × the noise, explained",
        lambda g: _ratio_share(_ratios(g, CLOSED), lambda r: r <= CLOSE),
        True,
    ),
    (
        "closed_far",
        "explained or nothing missing, yet over 2 × the noise held out",
        lambda g: _ratio_share(_ratios(g, CLOSED), lambda r: r > FAR),
        False,
    ),
    (
        "injected",
        "injected into real recordings: right group, 3 × what was left and more",
        lambda g: _found(
            [(c, n) for c, n in truths(g, 0.0) if (c.over_residual or 0.0) >= CLEAR_OF_RESIDUAL]
        ),
        True,
    ),
    (
        "injected_wrong",
        "injected into real recordings: cases with a wrong name",
        lambda g: _cases([c for c in g if c.injected and not c.failed], lambda c: bool(c.wrong)),
        False,
    ),
    (
        "named_before",
        "named without the injection, in no count",
        lambda g: sum(c.named_before for c in g),
        False,
    ),
    ("seconds", "seconds of a diagnosis, median", lambda g: _median(c.diagnose_s for c in g), False),
)


def figures(grades: Grades) -> dict[str, object]:
    """Every figure of these grades."""
    return {key: figure(grades) for key, _, figure, _ in FIGURES}


def summarise(grades: Grades) -> dict[str, object]:
    """Figures by track, their means with equal weights, and of all cases but `crime` together."""
    tracks = {t: figures([g for g in grades if g.track == t]) for t in sorted({g.track for g in grades})}
    proof = [g for g in grades if g.track != "crime"]
    return {
        "tracks": tracks,
        "together": figures(proof),
        "mean_of_tracks": {key: _mean_of(tracks, key) for key, *_ in FIGURES},
        "by_effect": _by(proof, lambda g, name: name),
        "by_form": _by(proof, lambda g, name: f"{name}: {g.forms.get(name, '–')}"),
        "by_truth": _by(proof, lambda g, name: g.family),
        "confusion": confusion(grades),
        "detection": detection(proof),
        "calibration": calibration([g.as_dict() for g in proof]),
        "worst": [
            f"{g.track}/{g.case}" for g in sorted(grades, key=badness, reverse=True)[:10] if any(badness(g))
        ],
        "stories": stories(grades),
    }


def stories(grades: Grades) -> list[str]:
    """Return the cases to describe in full: the first of each kind, whatever the outcome."""
    alien = [g for g in grades if g.track == "alien"]
    kinds = (
        [g for g in alien if len(g.severities) == 1],
        [g for g in alien if len(g.severities) > 1],
        [g for g in alien if g.null],
    )
    chosen = [g for kind in kinds for g in kind[:1]] + [g for g in grades if g.injected][:2]
    return [f"{g.track}/{g.case}" for g in chosen]


def _mean_of(tracks: dict[str, dict], key: str) -> float | None:
    values = [
        f[key]["share"] if isinstance(f[key], dict) else f[key] for t, f in tracks.items() if t != "crime"
    ]
    return _mean([v for v in values if v is not None])


def _by(grades: Grades, key: Callable[[Grade, str], str]) -> dict[str, dict[str, object]]:
    """For each key of a case and its truth: cases, right groups among the clear, cases with a wrong name."""
    pairs = [(g, name) for g in grades for name in [*g.truth, *g.unknown] or ["nothing"]]
    rows = {}
    for row in sorted({key(g, name) for g, name in pairs}):
        inside = [(g, name) for g, name in pairs if key(g, name) == row]
        clear = truths([g for g, _ in inside])
        rows[row] = {
            "cases": len(inside),
            "group": _found([pair for pair in inside if pair in clear]),
            "wrong": _cases((g for g, _ in inside), lambda g: bool(g.wrong)),
        }
    return rows


def badness(g: Grade) -> tuple[int, bool, float, float]:
    """Sort key for badness: wrong names, no answer, clear misses, bad predictions with a closed verdict."""
    missed = max(
        (g.severities[n] for n in g.truth if n not in g.found and g.severities[n] >= CLEAR), default=0.0
    )
    over = max(_ratios([g], CLOSED), default=0.0)
    return len(g.wrong), bool(g.failed), missed, over if over > FAR else 0.0


def answer_of(g: Grade) -> str:
    """The one name that the confusion matrix counts."""
    if g.failed:
        return "failed"
    if g.found:
        return (
            g.found[0]
            if g.found[0] in g.exact
            else next(n for n in g.named if n not in g.wrong + g.tolerated)
        )
    if g.wrong:
        return g.wrong[0]
    return "abstained" if g.verdict in STILL_OPEN else "nothing"


def confusion(grades: Grades) -> dict[str, object]:
    """Count truth against answer in cases with at most one effect; "abstained": left open, nothing named."""
    rows = [*NAMES, "nothing", "unknown"]
    columns = [*rows[:-1], "abstained", "other", "failed"]
    matrix = np.zeros((len(rows), len(columns)), dtype=int)
    for g in grades:
        if len(g.truth) + len(g.unknown) > 1 or g.named_before or g.track == "crime":
            continue
        truth = "unknown" if g.unknown else g.truth[0] if g.truth else "nothing"
        answer = answer_of(g)
        matrix[rows.index(truth), columns.index(answer if answer in columns else "other")] += 1
    return {"truth": rows, "answer": columns, "matrix": matrix.tolist()}


def detection(grades: Grades) -> list[dict[str, object]]:
    """Right groups and wrong names for single effects, by severity and by severity beyond refitted plays."""
    single = [g for g in grades if len(g.truth) == 1 and g.adequate and not g.named_before]
    rows = []
    for measure in ("severity", "severity_beyond_plays"):
        sizes = [
            (g, (g.severities if measure == "severity" else g.beyond_plays).get(g.truth[0])) for g in single
        ]
        for low, high in pairwise(BINS):
            inside = [g for g, size in sizes if size is not None and low <= size < high]
            rows.append(
                {
                    "measure": measure,
                    "from": low,
                    "to": None if high == float("inf") else high,
                    "right_group": _cases(inside, lambda g: bool(g.found)),
                    "wrong": _cases(inside, lambda g: bool(g.wrong)),
                }
            )
    return rows
