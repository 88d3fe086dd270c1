"""The page of `torchpi check`: what each recording holds, drawn, and the commands to go on with."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from torchpi.files import write_text
from torchpi.recordings.multi_axis import MultiAxisRecording
from torchpi.recordings.summary import Column, Summary
from torchpi.report import style
from torchpi.report.page import render
from torchpi.report.style import canvas
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
    title = "Check of " + ", ".join(each.summary.recording.name for each in checked)
    sections = [_section(number, each) for number, each in enumerate(checked, start=1)]
    return write_sections(title, sections, commands, provenance, path)


def write_sections(
    title: str,
    sections: Sequence[dict[str, Any]],
    commands: Sequence[str],
    provenance: Provenance,
    path: str | Path,
) -> Path:
    """Write the page of sections, one for each recording; returns its path."""
    html = render("check.html.j2", title=title, commands=commands, provenance=provenance, recordings=sections)
    write_text(path, html)
    return Path(path)


def recording_figure(summary: Summary) -> Figure:
    """Input and output over time, wrong readings marked, and the one over the other."""
    recording, wrong = summary.recording, summary.dropouts
    with canvas(4.4) as figure:
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
        lower.set(ylabel="output (µm)", xlabel="time (s)")
        loop.set(xlabel="input (V)", ylabel="output (µm)")
    return figure


def axes_section(
    number: int,
    source: str,
    recording: MultiAxisRecording,
    columns: Sequence[Column],
    facts: Sequence[tuple[str, str]],
) -> dict[str, Any]:
    """The section of a recording of several axes."""
    caption = f"{source}: inputs and outputs over time."
    t = np.arange(len(recording.u)) / recording.fs_hz
    with canvas(4.4) as figure:
        upper, lower = figure.subplots(2, 1, sharex=True)
        for axes, signals in ((upper, recording.u), (lower, recording.y)):
            for x in signals.T:
                axes.plot(*envelope(t, x), linewidth=0.8)
        upper.set_ylabel("inputs (V)")
        lower.set(ylabel="outputs (µm)", xlabel="time (s)")
    return {
        "source": source,
        "columns": columns,
        "facts": facts,
        "warnings": [],
        "svg": Markup(inline_svg(figure, f"r{number}", caption)),
        "caption": caption,
    }


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
