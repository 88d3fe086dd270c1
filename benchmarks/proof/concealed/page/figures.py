"""The pictures of the page."""

from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from concealed.judging.calibration import BINS
from matplotlib.figure import Figure


def save(figure: Figure, path: Path) -> None:
    """Save a figure as SVG."""
    # With a fixed salt and no date, the same results give the same bytes.
    with plt.rc_context({"svg.hashsalt": "proof"}):
        figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def confusion(results: dict, path: Path) -> None:
    """Draw the cases of each truth by answer; the shade is the share of the row."""
    found = results["confusion"]
    matrix = np.array(found["matrix"])
    share = matrix / np.maximum(matrix.sum(axis=1, keepdims=True), 1)
    figure, axes = plt.subplots(figsize=(11, 10), layout="constrained")
    axes.imshow(share, cmap="Blues", vmin=0, vmax=1)
    for i, j in zip(*np.nonzero(matrix), strict=True):
        colour = "white" if share[i, j] > 0.5 else "black"
        axes.text(j, i, str(matrix[i, j]), ha="center", va="center", color=colour, fontsize=8)
    axes.set_xticks(range(len(found["answer"])), found["answer"], rotation=90)
    axes.set_yticks(range(len(found["truth"])), found["truth"])
    axes.set(xlabel="answer", ylabel="truth")
    save(figure, path)


def detection(results: dict, path: Path) -> None:
    """Draw the shares of right groups and of wrong names against severity, with their bounds."""
    figure, panels = plt.subplots(1, 2, figsize=(11, 4), sharey=True, layout="constrained")
    measures = (
        ("severity", "severity, × noise"),
        ("severity_beyond_plays", "severity beyond plays, × noise"),
    )
    for axes, (measure, words) in zip(panels, measures, strict=True):
        rows = [r for r in results["detection"] if r["measure"] == measure and r["right_group"]["of"]]
        x = [1.4 * max(r["from"], 0.5) for r in rows]
        for key, label, colour in (("right_group", "right group", "C0"), ("wrong", "a wrong name", "C3")):
            share, low, high = (np.array([r[key][k] for r in rows]) for k in ("share", "at_least", "at_most"))
            axes.plot(x, share, "o-", color=colour, label=label)
            axes.fill_between(x, low.astype(float), high.astype(float), color=colour, alpha=0.15, linewidth=0)
        axes.set(xscale="log", xlim=(0.5, 100), ylim=(-0.02, 1.02), xlabel=words)
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("share of cases")
    panels[0].legend(loc="center right")
    save(figure, path)


def reliability(results: dict, path: Path) -> None:
    """Draw the share that is right against the stated probability, above a histogram of the names."""
    found = results["calibration"]
    figure, (top, bottom) = plt.subplots(
        2, 1, figsize=(6, 7), height_ratios=(3, 1), sharex=True, layout="constrained"
    )
    top.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    keys = (("by_itself", "the name itself", "o"), ("as_a_group", "with its alternatives", "s"))
    for key, label, marker in keys:
        if not found[key]["bins"]:
            continue
        rows = found[key]["bins"]
        x, y, low, high = (
            np.array([b[k] for b in rows]) for k in ("probability", "share", "at_least", "at_most")
        )
        top.errorbar(x, y, [y - low, high - y], fmt=marker, capsize=3, markersize=5, label=label)
        top.legend(loc="upper left", fontsize=8)
    top.set(ylabel="share that is right", ylim=(-0.03, 1.03), title=f"{found['names']} names")
    counts = found["by_itself"]["bins"]
    bottom.bar([b["from"] + 0.5 / BINS for b in counts], [b["of"] for b in counts], 0.9 / BINS, color="0.6")
    bottom.set(xlabel="stated probability", ylabel="names", xlim=(-0.03, 1.03))
    save(figure, path)


ALL: dict[str, Callable[[dict, Path], None]] = {
    "confusion": confusion,
    "detection": detection,
    "reliability": reliability,
}
