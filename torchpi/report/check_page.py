"""The page of `torchpi check`: what each recording holds, drawn, and the commands to go on with."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markupsafe import Markup
from matplotlib.figure import Figure

from torchpi.files import write_atomically
from torchpi.recordings.summary import Column, Summary
from torchpi.report import style
from torchpi.report.page import render
from torchpi.report.style import drawing, settle
from torchpi.report.svg import inline_svg
from torchpi.report.traces import envelope, thinned
from torchpi.report.what_was_run import Provenance


@dataclass(frozen=True)
class Checked:
    """A recording and its description."""

    summary: Summary
    columns: Sequence[Column]
    facts: Sequence[tuple[str, str]]
    """(what, how it is)"""


def write_check(
    checked: Sequence[Checked], commands: Sequence[str], provenance: Provenance, path: str | Path
) -> Path:
    """Write the page; returns its path."""
    html = render(
        "check.html.j2",
        title="Check of " + ", ".join(each.summary.recording.name for each in checked),
        commands=commands,
        provenance=provenance,
        recordings=[_section(number, each) for number, each in enumerate(checked, start=1)],
    )
    with write_atomically(path) as temporary:
        temporary.write_text(html, encoding="utf-8")
    return Path(path)


def recording_figure(summary: Summary) -> Figure:
    """Input and output over time, wrong readings marked, and the one over the other."""
    recording, wrong = summary.recording, summary.dropouts
    with drawing():
        figure = Figure(figsize=(style.WIDTH_IN, 4.4))
        grid = figure.add_gridspec(2, 2, width_ratios=(1.6, 1))
        upper = figure.add_subplot(grid[0, 0])
        lower = figure.add_subplot(grid[1, 0], sharex=upper)
        loop = figure.add_subplot(grid[:, 1])
        upper.plot(*envelope(recording.t, recording.u), **style.WITHOUT)
        lower.plot(*envelope(recording.t, recording.y), **style.TORCHPI)
        loop.plot(*thinned(recording.u, recording.y), **{**style.TORCHPI, "linewidth": 0.8})
        for axes, x in ((lower, recording.t), (loop, recording.u)):
            axes.plot(x[wrong], recording.y[wrong], "x", color=style.OTHERS[0]["color"])
        upper.set_ylabel("input (V)")
        lower.set_ylabel("output (µm)")
        lower.set_xlabel("time (s)")
        loop.set_xlabel("input (V)")
        loop.set_ylabel("output (µm)")
        settle(figure)
    return figure


def _section(number: int, each: Checked) -> dict[str, Any]:
    source = each.summary.recording.source
    caption = f"{source}: input and output over time, and the output over the input."
    if len(each.summary.dropouts):
        caption += " Crosses mark single wrong readings."
    return {
        "source": source,
        "columns": each.columns,
        "facts": each.facts,
        "warnings": each.summary.warnings,
        "svg": Markup(inline_svg(recording_figure(each.summary), f"r{number}", caption)),
        "caption": caption,
    }
