"""The page as Markdown: every figure with its count and its bound, beside the rivals'."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from concealed.cases import Case
from concealed.judging.summary import FIGURES
from concealed.page import cases, figures

BETTER_MORE = {key: more for key, _, _, more in FIGURES}
WORDS = {key: words for key, words, _, _ in FIGURES}
# Goals of the run: for the value, and for its bound. For the intervals both ends of COVERAGE count.
COVERAGE = (0.86, 0.94)
GOALS: dict[str, tuple[float, float | None]] = {
    "false_alarms": (0.01, 0.02),
    "precision": (0.97, 0.95),
    "group": (0.90, 0.85),
    "exact": (0.80, None),
    "foreign": (0.80, None),
    "foreign_wrong": (0.05, None),
    "unknown": (0.90, None),
    "pairs": (0.80, None),
    "triples_f1": (0.85, None),
    "calibration_error": (0.05, None),
    "intervals": (COVERAGE[0], None),
    "heldout": (1.15, None),
    "heldout_close": (0.90, None),
    "injected": (0.85, None),
    "injected_wrong": (0.03, None),
}

Results = Mapping[str, dict]


def write_page(results: Results, output: Path, data: Path | None = None) -> None:
    """Write OUTPUT and its pictures, from the results of the tool (first) and of its rivals.

    The worst cases are drawn again if `data`, the folder of the real recordings, is given.
    """
    tool, first = next(iter(results.items()))
    folder = output.parent / output.stem
    folder.mkdir(parents=True, exist_ok=True)
    for name, draw in figures.ALL.items():
        draw(first, folder / f"{name}.svg")
    picture = lambda name, text: f"![{text}]({folder.name}/{name}.svg)"  # noqa: E731
    shown = {} if data is None else {name: cases.drawn(first, name, data) for name in _shown(first)}
    for name, case in shown.items():
        cases.picture(case, name, folder / f"{_file(name)}.svg")
    pictures = {name: picture(_file(name), f"The case {name}") for name in shown}
    parts = [
        f"# How often {tool} is right",
        _about(first),
        "## All figures, beside the rivals'",
        "All tracks but `crime` together; a share, its count, and the one-sided 95 % bound of Clopper and "
        "Pearson (1934). *Goal* is what the run was to reach, in the value and, behind a slash, in the "
        "bound; ✗ marks what falls short.",
        figure_table(results, goals=True),
        "## By track",
        "`crime` is the library's own equations, written again: it shows how flattering that is. It is no "
        "result. *Mean* gives each other track the same weight.",
        figure_table({tool: first}, tracks=True),
        "## Truth against answer",
        "Cases with at most one effect. *Abstained*: the verdict stays open, and nothing is named.",
        picture("confusion", "Confusion matrix"),
        "## Detection against severity",
        "Single effects; bands are two-sided 90 % (each side 95 %). *Beyond plays* is what forty refitted "
        "plays leave of the effect: the part that no other hysteresis explains.",
        picture("detection", "Right group and wrong names against severity"),
        _detection_table(first["detection"]),
        "## Do the probabilities hold?",
        picture("reliability", "Reliability diagram"),
        _calibration(first["calibration"]),
        "## By effect",
        _rows(first["by_effect"], "effect"),
        "## By form",
        _rows(first["by_form"], "effect: form"),
        "## By truth",
        _rows(first["by_truth"], "hysteresis, or recording"),
        "## The ten worst cases",
        _worst(first),
        *(pictures[name] for name in first["worst"] if name in shown),
        *_stories(first, shown, pictures),
        "## What it cannot do",
        _limits(first),
        "## Every case",
        "`results.json` of the run has them all. This page is what `python -m concealed page` makes of it; "
        "nothing here is written by hand.",
    ]
    output.write_text("\n\n".join(part for part in parts if part) + "\n")


def _about(results: dict) -> str:
    seeds = ", ".join(
        f"`{track}` {seed} ({results['counts'][track]} cases)" for track, seed in results["seeds"].items()
    )
    drawn = results["drawn"]
    when = f"Measured on {drawn[:10]} at" if drawn else "For development, of"
    cases = sum(results["counts"].values())
    return (
        f"{when} commit {results['commit'][:12]}: {cases} cases, seeds "
        f"{f'drawn {drawn}' if drawn else 'by hand'}: {seeds}. "
        f"The commands: `{results['diagnose']}`"
        + (f" and `{results['predict']}`." if results["predict"] else ".")
    )


def figure_table(results: Results, *, tracks: bool = False, goals: bool = False) -> str:
    """Return a table with one row per figure and one column per tool, or per track with their mean."""
    if tracks:
        (only,) = results.values()
        columns = {**only["tracks"], "mean": only["mean_of_tracks"]}
    else:
        columns = {name: found["together"] for name, found in results.items()}
    head = ["", *(["goal"] if goals else []), *columns]
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for key, words in WORDS.items():
        values = [figures_of.get(key) for figures_of in columns.values()]
        if all(cell(value, key) == "–" for value in values):
            continue
        goal = [_goal(key, values[0])] if goals else []
        lines.append("| " + " | ".join([words, *goal, *(cell(value, key) for value in values)]) + " |")
    return "\n".join(lines)


def cell(value: object, key: str) -> str:
    """Format a figure for the tables."""
    if value is None:
        return "–"
    if isinstance(value, dict):
        if value["share"] is None:
            return "–"
        more = BETTER_MORE.get(key, True)
        bound = value["at_least"] if more else value["at_most"]
        sign = "≥" if more else "≤"
        return f"{_percent(value['share'])} ({value['count']}/{value['of']}; {sign} {_percent(bound)})"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def _goal(key: str, value: object) -> str:
    if key not in GOALS:
        return ""
    goal, bound = GOALS[key]
    more = BETTER_MORE[key]
    shares = isinstance(value, dict)
    shown = f"{'≥' if more else '≤'} {_percent(goal) if shares else f'{goal:g}'}"
    shown += f" / {_percent(bound)}" if bound is not None else ""
    shown += f", ≤ {_percent(COVERAGE[1])}" if key == "intervals" else ""
    return shown + " ✗" * (not reached(key, value))


def reached(key: str, value: object) -> bool:
    """Whether a figure and its bound reach the goal; what was not measured does not."""
    goal, bound = GOALS[key]
    more = BETTER_MORE[key]
    if value is None or (isinstance(value, dict) and value["share"] is None):
        return False
    if not isinstance(value, dict):
        return value >= goal if more else value <= goal
    if key == "intervals":
        return COVERAGE[0] <= value["share"] <= COVERAGE[1]
    if more:
        return value["share"] >= goal and (bound is None or value["at_least"] >= bound)
    return value["share"] <= goal and (bound is None or value["at_most"] <= bound)


def _detection_table(rows: Sequence[dict]) -> str:
    lines = ["| severity | cases | right group | a wrong name |", "|---|---|---|---|"]
    for row in rows:
        if row["right_group"]["of"]:
            beyond = "" if row["measure"] == "severity" else " beyond plays"
            to = " and above" if row["to"] is None else f"–{row['to']:g}"
            found, wrong = cell(row["right_group"], ""), cell(row["wrong"], "failed")
            lines.append(
                f"| {row['from']:g}{to} ×{beyond} | {row['right_group']['of']} | {found} | {wrong} |"
            )
    return "\n".join(lines)


def _calibration(found: dict) -> str:
    lines = [
        f"{found['names']} names; {found['tolerated']} that are tolerated, and "
        f"{found['without_a_probability']} without a probability, are left out.",
        "",
        "| | Brier score | calibration error | of it by chance: mean, 95 % below |",
        "|---|---|---|---|",
    ]
    for key, words in (("by_itself", "the name itself"), ("as_a_group", "with its alternatives")):
        row = found[key]
        if row["bins"]:
            chance = row["by_chance"]
            lines.append(
                f"| {words} | {row['brier']:.3f} | {row['expected_calibration_error']:.3f} | "
                f"{chance['mean']:.3f}, {chance['below']:.3f} |"
            )
    return "\n".join(lines)


def _rows(rows: dict[str, dict], words: str) -> str:
    lines = [f"| {words} | cases | right group, 2 × and more | a wrong name |", "|---|---|---|---|"]
    for name, row in rows.items():
        lines.append(
            f"| {name} | {row['cases']} | {cell(row['group'], '')} | {cell(row['wrong'], 'failed')} |"
        )
    return "\n".join(lines)


def _worst(results: dict) -> str:
    cases = {f"{case['track']}/{case['case']}": case for case in results["cases"]}
    lines = [
        "| case | over | missing (× noise) | answer | wrong | held-out over noise |",
        "|---|---|---|---|---|---|",
    ]
    for name in results["worst"]:
        case = cases[name]
        truth = ", ".join(f"{n} {s:.1f}" for n, s in case["severities"].items()) or "nothing"
        said = case["failed"] or f"{case['verdict']}: {', '.join(case['named']) or 'no name'}"
        ratio = cell(case["heldout_over_noise"], "")
        wrong = ", ".join(case["wrong"]) or "–"
        lines.append(
            f"| {name} | {case['family']} | {truth} | {said.replace('|', '/')} | {wrong} | {ratio} |"
        )
    return (
        "\n".join(lines)
        if results["worst"]
        else "No case has a wrong name, a failure or a clear effect that was missed."
    )


def _shown(results: dict) -> list[str]:
    """The cases with a picture, each once."""
    return list(dict.fromkeys([*results["worst"], *results["stories"]]))


def _file(name: str) -> str:
    return name.replace("/", "_")


def _stories(results: dict, shown: Mapping[str, Case], pictures: Mapping[str, str]) -> list[str]:
    """Describe some cases in full, whatever the outcome."""
    told = [cases.story(results, n, shown[n], pictures[n]) for n in results["stories"] if n in shown]
    head = [
        "## Five cases told",
        "The first of their kind, whatever came of them: one effect, several, and none on alien plants; two "
        "real recordings into which an effect was put. The picture has the first recording.",
    ]
    return [*head, *told] if told else []


def _limits(results: dict) -> str:
    together = results["together"]
    short = [
        f"- {WORDS[key]}: {cell(together[key], key)}, goal {_goal(key, together[key]).removesuffix(' ✗')}"
        for key in GOALS
        if not reached(key, together[key])
    ]
    rows = results["by_effect"].items()
    seldom = [
        f"`{n}` ({cell(r['group'], '')})" for n, r in rows if r["group"]["of"] and r["group"]["share"] < 0.5
    ]
    lines = ["Goals that were not reached:", *short] if short else ["Every goal was reached."]
    if seldom:
        lines += ["", f"Found in fewer than half of the clear cases: {', '.join(seldom)}."]
    return "\n".join(lines)
