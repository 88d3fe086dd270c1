"""The confusion matrix, and what is found against how severe it is, on one sheet."""

from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt


def draw(summary: dict, path: Path) -> None:
    """Write the figure."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(17, 9), width_ratios=(2, 1), layout="constrained")
    confusion = summary["confusion"]
    matrix = np.array(confusion["matrix"])
    share = matrix / np.maximum(matrix.sum(axis=1, keepdims=True), 1)
    left.imshow(share, cmap="Blues", vmin=0, vmax=1)
    for i, j in zip(*np.nonzero(matrix), strict=True):
        left.text(
            j, i, matrix[i, j], ha="center", va="center", color="white" if share[i, j] > 0.5 else "black"
        )
    left.set_xticks(range(len(confusion["answer"])), confusion["answer"], rotation=90)
    left.set_yticks(range(len(confusion["truth"])), confusion["truth"])
    left.set(xlabel="answer", ylabel="truth", title="Single effects, nothing and unknown: cases")
    for measure, style in (("severity", "o-"), ("severity_beyond_plays", "s--")):
        rows = [r for r in summary["detection"] if r["measure"] == measure and r["cases"]]
        middle = [max(r["from"], 0.5) * 1.4 for r in rows]
        right.plot(
            middle, [r["right_group"] / r["cases"] for r in rows], style, label=f"right group, by {measure}"
        )
        right.plot(middle, [r["wrong"] / r["cases"] for r in rows], style, color="tab:red", alpha=0.5)
    right.set(xscale="log", ylim=(-0.02, 1.02), xlabel="severity, × noise rms", ylabel="share of cases")
    right.set_title("Single effects: right group; wrong in red")
    right.grid(alpha=0.3)
    right.legend()
    figure.savefig(path, dpi=110)
    plt.close(figure)
