"""The comparison as a figure: held-out error against the time to fit."""

import math
from collections.abc import Sequence

from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from row import Row

from torchpi.report import style
from torchpi.report.style import canvas


def error_against_time(rows: Sequence[Row]) -> Figure:
    """Plot one point per peer at its time without compilation, and a line to the time with it."""
    with canvas(4.2) as figure:
        axes = figure.subplots()
        axes.set_xscale("log")
        axes.set_yscale("log")
        labelled: list[Row] = []
        for row in sorted(rows, key=lambda row: row.fit_s):
            ours = row.peer.name.startswith("torchpi")
            color = style.TORCHPI["color"] if ours else "#000000"
            error = _percent(row)
            axes.plot([row.fit_s, row.whole_s], [error, error], color=color, linewidth=0.9)
            axes.plot(row.whole_s, error, color=color, marker="|", markersize=11)
            axes.plot(row.fit_s, error, color=color, marker="o" if ours else "s", markersize=6, zorder=3)
            below = sum(_near(row, other) for other in labelled) % 2 == 1
            axes.annotate(
                row.peer.name,
                (row.fit_s, error),
                xytext=(0, -9 if below else 9),
                textcoords="offset points",
                ha="center",
                va="top" if below else "bottom",
                fontsize=8,
                color=color,
            )
            labelled.append(row)
        axes.margins(x=0.14, y=0.14)
        axes.set_xlabel(f"time to fit {rows[0].samples:,} samples (s)")
        axes.set_ylabel("held-out rms error (% of range)")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))
            axis.set_minor_formatter(NullFormatter())
    return figure


def _percent(row: Row) -> float:
    return 100 * row.rms_v / row.range_v


def _near(one: Row, other: Row) -> bool:
    """Whether labels on the same side would overlap."""
    decades = abs(math.log10(one.fit_s / other.fit_s)), abs(math.log10(_percent(one) / _percent(other)))
    return decades[0] < 1.2 and decades[1] < 0.05
