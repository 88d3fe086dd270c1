"""Do the stated probabilities hold? Reliability, Brier score, calibration error, coverage of intervals.

    python benchmarks/calibration.py recordings/answers --output calibration

Reads every results.json under the folders, as benchmarks/concealed/judge.py and benchmarks/real/score.py
write them, and takes each name that an answer gives, with its probability. What a grader tolerates, or what
the untouched recording has as well, is neither right nor wrong, and is left out. A name is right by itself
where it is the truth, or one that u and y cannot split from it; it is right as a group where the truth is
among its alternatives as well. Writes calibration.json and calibration.png.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray

matplotlib.use("Agg")
import matplotlib.pyplot as plt

sys.path.append(str(Path(__file__).parent / "concealed"))

from judging.proportions import share

BINS = 10
DRAWS = 2000  # of a perfectly calibrated tool that states the same probabilities
SEVERITY = 2.0  # intervals of fainter effects are not counted, as in the concealed proof


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+", help="of graded answers, searched to any depth")
    parser.add_argument("--output", type=Path, required=True, help="folder for the JSON and the figure")
    options = parser.parse_args()
    files = sorted(file for folder in options.folders for file in folder.rglob("results.json"))
    cases = [case for file in files for case in json.loads(file.read_text())["cases"]]
    if not cases:
        parser.error(f"found no graded case in {', '.join(map(str, options.folders))}, expected results.json")
    results = {"files": [str(file) for file in files], **calibration(cases)}
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / "calibration.json").write_text(json.dumps(results, indent=1) + "\n")
    draw(results, options.output / "calibration.png")
    print(report(results))


def calibration(cases: Sequence[dict]) -> dict[str, object]:
    """All figures over graded cases, each with `stated` names and compared `parameters`."""
    stated = [name for case in cases for name in case["stated"]]
    judged = [name for name in stated if name["right"] is not None]
    known = [name for name in judged if name["probability"] is not None]
    probabilities = np.array([name["probability"] for name in known])
    intervals = [
        row["covered"]
        for case in cases
        for row in case["parameters"]
        if row.get("covered") is not None and (row["severity"] or 0.0) >= SEVERITY
    ]
    return {
        "cases": len(cases),
        "names": len(known),
        "tolerated": len(stated) - len(judged),
        "without_a_probability": len(judged) - len(known),
        "by_itself": reliability(probabilities, np.array([bool(n["right"]) for n in known])),
        "as_a_group": reliability(probabilities, np.array([bool(n["right_group"]) for n in known])),
        "interval_coverage": share(sum(intervals), len(intervals)),
    }


def reliability(probabilities: NDArray[np.float64], right: NDArray[np.bool_]) -> dict[str, object]:
    """Brier score, expected calibration error, and the share that is right in each bin of probability.

    The calibration error of few names is above zero by chance alone: `by_chance` is its mean, and the value
    that 95 % stay below, for a tool that is right as often as it states.
    """
    if probabilities.size == 0:
        return {"brier": None, "expected_calibration_error": None, "by_chance": None, "bins": []}
    inside = np.minimum((probabilities * BINS).astype(int), BINS - 1)
    bins = [
        {
            "from": k / BINS,
            "to": (k + 1) / BINS,
            "probability": float(probabilities[inside == k].mean()),
            **share(int(right[inside == k].sum()), int(np.sum(inside == k))),
        }
        for k in range(BINS)
        if np.any(inside == k)
    ]
    rng = np.random.default_rng(0)
    by_chance = [
        _calibration_error(probabilities, rng.random(probabilities.size) < probabilities, inside)
        for _ in range(DRAWS)
    ]
    return {
        "brier": float(np.mean((probabilities - right) ** 2)),
        "expected_calibration_error": _calibration_error(probabilities, right, inside),
        "by_chance": {"mean": float(np.mean(by_chance)), "below": float(np.quantile(by_chance, 0.95))},
        "bins": bins,
    }


def _calibration_error(
    probabilities: NDArray[np.float64], right: NDArray[np.bool_], inside: NDArray[np.int_]
) -> float:
    """Σ n_k / n |share that is right - mean probability| over the bins."""
    excess = np.bincount(inside, weights=right - probabilities, minlength=BINS)
    return float(np.sum(np.abs(excess)) / probabilities.size)


def draw(results: dict, path: Path) -> None:
    """The reliability diagram, by itself and as a group, over a count of the names in each bin."""
    figure, (top, bottom) = plt.subplots(
        2, 1, figsize=(6, 7), height_ratios=(3, 1), sharex=True, layout="constrained"
    )
    top.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    for key, label, marker in (
        ("by_itself", "the name itself", "o"),
        ("as_a_group", "with its alternatives", "s"),
    ):
        bins = results[key]["bins"]
        if not bins:
            continue
        x, y = (np.array([b[k] for b in bins]) for k in ("probability", "share"))
        ends = np.array([[b["at_least"], b["at_most"]] for b in bins]).T
        top.errorbar(
            x,
            y,
            np.abs(ends - y),
            fmt=marker,
            capsize=3,
            markersize=5,
            label=f"{label}: {_scores(results[key])}",
        )
    top.set(ylabel="share that is right", ylim=(-0.03, 1.03), title=f"{results['names']} names")
    top.legend(loc="lower right", fontsize=8)
    bins = results["by_itself"]["bins"]
    bottom.bar([b["from"] + 0.5 / BINS for b in bins], [b["of"] for b in bins], 0.9 / BINS, color="0.6")
    bottom.set(xlabel="stated probability", ylabel="names", xlim=(-0.03, 1.03))
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _scores(figures: dict) -> str:
    return f"Brier {figures['brier']:.3f}, calibration error {figures['expected_calibration_error']:.3f}"


def report(results: dict) -> str:
    """The figures as text."""
    lines = [
        f"{results['names']} names in {results['cases']} cases; {results['tolerated']} tolerated, "
        f"{results['without_a_probability']} without a probability"
    ]
    for key, words in (("by_itself", "the name itself"), ("as_a_group", "with its alternatives")):
        figures = results[key]
        if figures["bins"]:
            chance = figures["by_chance"]
            lines += [
                f"{words}: {_scores(figures)} (by chance {chance['mean']:.3f}, below {chance['below']:.3f})",
                "  stated       names  right  share  90 % interval",
            ]
            lines += [
                f"  {b['from']:.1f} to {b['to']:.1f}  {b['of']:6d} {b['count']:6d}   {b['share']:.2f}  "
                f"{b['at_least']:.2f} to {b['at_most']:.2f}"
                for b in figures["bins"]
            ]
    cover = results["interval_coverage"]
    if cover["of"]:
        lines.append(
            f"90 % intervals cover {cover['count']} of {cover['of']} ({100 * cover['share']:.0f} %; "
            f"{100 * cover['at_least']:.0f} to {100 * cover['at_most']:.0f} %)"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
