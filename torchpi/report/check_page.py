"""The page of `torchpi check`: figures and facts of each recording, and the commands to continue with."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torchpi.files import write_text
from torchpi.recordings.multi_axis import MultiAxisRecording
from torchpi.recordings.summary import Column, Summary
from torchpi.report import style, words
from torchpi.report.linked import MOST_NUMBERS, linked_markup
from torchpi.report.linked_traces import axes_traces, recording_traces
from torchpi.report.page import render
from torchpi.report.style import canvas
from torchpi.report.svg import inline_svg
from torchpi.report.traces import envelope, thinned
from torchpi.report.what_was_run import Provenance

WRONG: dict[str, Any] = {"color": style.OTHERS[0]["color"], "marker": "x", "linestyle": ""}


@dataclass(frozen=True)
class Checked:
    """A recording and its description."""

    summary: Summary
    columns: Sequence[Column]
    facts: Sequence[tuple[str, str]]
    """Pairs of a name and a description."""


def write_check(
    checked: Sequence[Checked],
    refused: Sequence[str],
    commands: Sequence[str],
    provenance: Provenance,
    path: str | Path,
) -> Path:
    """Write the page of the usable files, and why the others are refused; return its path."""
    title = "Check of " + ", ".join(each.summary.recording.name for each in checked)
    most = MOST_NUMBERS / len(checked)
    sections = [_section(number, each, most) for number, each in enumerate(checked, start=1)]
    return write_sections(title, sections, refused, commands, provenance, path)


def write_sections(
    title: str,
    sections: Sequence[dict[str, Any]],
    refused: Sequence[str],
    commands: Sequence[str],
    provenance: Provenance,
    path: str | Path,
) -> Path:
    """Write the page from sections, one for each recording; return its path."""
    html = render(
        "check.html.j2",
        title=title,
        answer=_answer(sections, refused),
        refused=refused,
        commands=commands,
        provenance=provenance,
        recordings=sections,
    )
    write_text(path, html)
    return Path(path)


def recording_figure(summary: Summary) -> Figure:
    """Draw input and output over time, with wrong readings marked, and output over input."""
    with canvas(4.4) as figure:
        grid = figure.add_gridspec(2, 2, width_ratios=(1.6, 1))
        upper = figure.add_subplot(grid[0, 0])
        _over_time(summary, upper, figure.add_subplot(grid[1, 0], sharex=upper))
        _loop(summary, figure.add_subplot(grid[:, 1]))
    return figure


def time_figure(summary: Summary) -> Figure:
    """Draw input and output over time, with wrong readings marked."""
    with canvas(3.8) as figure:
        _over_time(summary, *figure.subplots(2, 1, sharex=True))
    return figure


def loop_figure(summary: Summary) -> Figure:
    """Draw output over input, with wrong readings marked."""
    with canvas(3.4, 0.62 * style.WIDTH_IN) as figure:
        _loop(summary, figure.subplots())
    return figure


def _over_time(summary: Summary, upper: Axes, lower: Axes) -> None:
    recording, wrong = summary.recording, summary.dropouts
    upper.plot(*envelope(recording.t, recording.u), **style.WITHOUT)
    lower.plot(*envelope(recording.t, recording.y), **style.TORCHPI)
    lower.plot(recording.t[wrong], recording.y[wrong], **WRONG)
    upper.set_ylabel("input (V)")
    lower.set(ylabel="output (µm)", xlabel="time (s)")


def _loop(summary: Summary, axes: Axes) -> None:
    recording, wrong = summary.recording, summary.dropouts
    axes.plot(*thinned(recording.u, recording.y), **{**style.TORCHPI, "linewidth": 0.8})
    axes.plot(recording.u[wrong], recording.y[wrong], **WRONG)
    axes.set(xlabel="input (V)", ylabel="output (µm)")


def axes_section(
    number: int,
    source: str,
    recording: MultiAxisRecording,
    columns: Sequence[Column],
    facts: Sequence[tuple[str, str]],
) -> dict[str, Any]:
    """Return the section of a recording of several axes."""
    caption = f"{source}: inputs and outputs over time."
    t = np.arange(len(recording.u)) / recording.fs_hz
    with canvas(4.4) as figure:
        upper, lower = figure.subplots(2, 1, sharex=True)
        for axes, signals in ((upper, recording.u), (lower, recording.y)):
            for x in signals.T:
                axes.plot(*envelope(t, x), linewidth=0.8)
        upper.set_ylabel("inputs (V)")
        lower.set(ylabel="outputs (µm)", xlabel="time (s)")
    svg = linked_markup(
        [axes_traces(t, recording.u, recording.y)], Markup(inline_svg(figure, f"r{number}", caption))
    )
    return {
        "source": source,
        "name": recording.name,
        "sampling": _sampling(recording.fs_hz, len(recording.u)),
        "columns": columns,
        "facts": facts,
        "warnings": [],
        "figures": [{"svg": svg, "caption": caption}],
    }


def _section(number: int, each: Checked, most: float) -> dict[str, Any]:
    recording = each.summary.recording
    crosses = " Crosses mark single wrong readings." if len(each.summary.dropouts) else ""
    over_time, loop = (
        f"{recording.source}: {what}." for what in ("input and output over time", "output against input")
    )
    still = Markup(inline_svg(time_figure(each.summary), f"r{number}", over_time + crosses))
    return {
        "source": recording.source,
        "name": recording.name,
        "sampling": f"{_sampling(recording.fs_hz, len(recording))}, "
        f"noise about {words.length(each.summary.output_noise_um, 2)}",
        "columns": each.columns,
        "facts": each.facts,
        "warnings": each.summary.warnings,
        "figures": [
            {"svg": linked_markup([recording_traces(recording)], still, most), "caption": over_time},
            {
                "svg": Markup(inline_svg(loop_figure(each.summary), f"l{number}", loop + crosses)),
                "caption": loop + crosses,
            },
        ],
    }


def _sampling(fs_hz: float, samples: int) -> str:
    return f"{fs_hz:,.6g} Hz, {samples / fs_hz:.4g} s"


def _answer(sections: Sequence[dict[str, Any]], refused: Sequence[str]) -> tuple[str, str]:
    """Return whether the files can be used, and the first reason or warning."""
    files = len(sections) + len(refused)
    if refused:
        return f"{len(refused)} of {files} cannot be used", refused[0]
    warned = [section for section in sections if section["warnings"]]
    if warned:
        return "Usable, with a warning", f"{warned[0]['source']}: {warned[0]['warnings'][0]}"
    which = {1: "the recording", 2: "both recordings"}.get(files, f"all {files} recordings")
    return "Usable", f"{which}, without a warning"
