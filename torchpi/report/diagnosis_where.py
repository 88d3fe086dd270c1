"""Figures of where the residual of a diagnosis lies: maps, and the lines of a periodic input."""

from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from torchpi.diagnosis.diagnosis import Where
from torchpi.diagnosis.locate import SIGNIFICANT
from torchpi.diagnosis.multisine import Parts
from torchpi.report import words
from torchpi.report.diagnosis_style import (
    SILENT_NM,
    STRONG,
    plain_numbers,
    shortened,
    unit_of,
)
from torchpi.report.style import canvas
from torchpi.report.traces import Signal


def where_figure(where: Sequence[Where]) -> Figure:
    """Draw the share of each cell in the eight domains; significant cells are dark."""
    strips = _strips(where)
    with canvas(6.2 + 0.3 * len(strips)) as figure:
        grid = figure.add_gridspec(5, 2, height_ratios=(0.62 + 0.3 * len(strips), 1.5, 1.5, 1.5, 1.5))
        _heat_strips(figure.add_subplot(grid[0, :]), strips)
        _bands(figure.add_subplot(grid[1, :]), _map(where, "frequency"), "frequency (Hz)", "frequency", True)
        _bands(
            figure.add_subplot(grid[2, 0]),
            _map(where, "displacement"),
            "displacement y (µm)",
            "displacement",
        )
        signed = [cell for cell in where if cell.domain == "rate" and cell.label != "either way"]
        _signed_rate(figure.add_subplot(grid[2, 1]), signed)
        _bands(
            figure.add_subplot(grid[3, 0]),
            _map(where, "since_reversal"),
            "time since the input reversed (s)",
            "time since the last reversal",
            True,
        )
        size = [cell for cell in where if cell.domain == "rate" and cell.label == "either way"]
        _bands(figure.add_subplot(grid[3, 1]), size, "magnitude of the input's rate (V/s)", "rate", True)
        _bands(
            figure.add_subplot(grid[4, 0]),
            _map(where, "amplitude"),
            "swing of the input, peak to peak (V)",
            "amplitude level",
        )
        both = grid[4, 1].subgridspec(1, 2, width_ratios=(1, 1.3))
        _names(figure.add_subplot(both[0]), _map(where, "direction"), "direction")
        _names(figure.add_subplot(both[1]), _map(where, "recording"), "recording")
    return figure


def multisine_figure(parts: Parts) -> Figure:
    """Draw the residual's spectral lines by kind (excited, even, odd), and the noise expected on each."""
    unit = unit_of(float(parts.amplitude_um.max()))
    marks: dict[str, tuple[str, dict[str, Any]]] = {
        "linear": ("excited", {"color": "#999999", "marker": "."}),
        "even": ("even, not excited", {"color": "#0072B2", "marker": "^"}),
        "odd": ("odd, not excited", {"color": "#D55E00", "marker": "s"}),
        "mains": ("near the mains, not excited", {"color": "#000000", "marker": "x"}),
    }
    highest = 3 * float(parts.hz[parts.kind == "linear"].max())
    shown = parts.hz <= highest
    with canvas(3.0) as figure:
        axes = figure.subplots()
        for kind, (label, mark) in marks.items():
            mask = _loudest(shown & (parts.kind == kind), parts.amplitude_um)
            if mask.any():
                axes.plot(
                    parts.hz[mask], unit.per_um * parts.amplitude_um[mask], ls="", ms=3.4, label=label, **mark
                )
        k = np.flatnonzero(shown)[:: max(1, int(shown.sum()) // 400)]
        axes.plot(
            parts.hz[k],
            unit.per_um * parts.noise_amplitude_um[k],
            color="#000000",
            lw=1.2,
            label="noise, rms",
        )
        typical = unit.per_um * float(np.median(parts.noise_amplitude_um[shown]))
        axes.set(
            ylim=(
                max(0.2 * typical, SILENT_NM),
                max(10 * SILENT_NM, 2 * unit.per_um * float(parts.amplitude_um[shown].max())),
            ),
            xscale="log",
            yscale="log",
        )
        plain_numbers(axes)
        axes.set(
            xlabel="frequency (Hz)",
            ylabel=f"amplitude of the residual ({unit.name})",
            title=f"{shortened(parts.recording)}, from {parts.start_s:.3g} s: spectral lines of the residual",
        )
        axes.legend(
            loc="upper center",
            bbox_to_anchor=(0.5, -0.17),
            ncols=5,
            handletextpad=0.3,
            columnspacing=1.2,
            markerscale=1.4,
        )
    return figure


def _map(where: Sequence[Where], domain: str) -> list[Where]:
    return [cell for cell in where if cell.domain == domain]


def _strips(where: Sequence[Where]) -> dict[str, list[Where]]:
    """Return the cells over time, in s, by recording."""
    strips: dict[str, list[Where]] = {}
    for cell in where:
        if cell.domain == "time" and cell.unit == "s":
            strips.setdefault(cell.label, []).append(cell)
    return strips


def _heat_strips(axes: Axes, strips: dict[str, list[Where]]) -> None:
    """Draw one strip per recording, as long as it lasted, dark where the residual is large."""
    most = max((cell.share for strip in strips.values() for cell in strip), default=0.0) or 1.0
    colours = matplotlib.colormaps["Blues"]
    longest = 0.0
    for at, strip in enumerate(strips.values()):
        first = strip[0].range[0]
        for cell in strip:
            low, high = cell.range[0] - first, cell.range[1] - first
            longest = max(longest, high)
            axes.barh(
                at,
                high - low,
                left=low,
                height=0.8,
                color=colours(cell.share / most),
                edgecolor="#777777",
                linewidth=0.5,
            )
            if cell.share >= 0.01:
                dark = cell.share > 0.55 * most
                axes.text(
                    (low + high) / 2,
                    at,
                    f"{100 * cell.share:.0f}",
                    ha="center",
                    va="center",
                    fontsize=8,
                    color="#ffffff" if dark else "#000000",
                    fontweight="bold" if cell.significance > SIGNIFICANT else "normal",
                )
    axes.set_yticks(range(len(strips)), [shortened(name) for name in strips])
    axes.set_xlim(0, longest or 1.0)
    axes.invert_yaxis()
    axes.grid(False)
    axes.set(xlabel="time in the recording (s)", title="time: share in each twelfth of a recording (%)")


def _bands(axes: Axes, cells: Sequence[Where], label: str, title: str, log: bool = False) -> None:
    """Draw bars as wide as their cells."""
    lows, highs = [cell.range[0] for cell in cells], [cell.range[1] for cell in cells]
    if log and highs:
        # On the logarithmic axis, the cell that begins at 0 is drawn as wide as its neighbour.
        smallest = min(highs) * (min(highs) / highs[1] if len(highs) > 1 else 0.5)
        lows = [low if low > 0 else smallest for low in lows]
        axes.set_xscale("log")
    for low, high, cell in zip(lows, highs, cells, strict=True):
        axes.bar(low, 100 * cell.share, width=high - low, align="edge", **_look(cell))
    if log:
        plain_numbers(axes, y=False)
    axes.set_xlabel(label)
    _finish(axes, cells, title)


def _signed_rate(axes: Axes, cells: Sequence[Where]) -> None:
    """Draw bars of equal width, each labelled with the end of its cell that is farther from 0."""
    for at, cell in enumerate(cells):
        axes.bar(at, 100 * cell.share, width=0.9, **_look(cell))
    names = []
    for cell in cells:
        low, high = cell.range
        sign = "±" if low < 0 < high else "−" if high <= 0 else "+"
        names.append(sign + words.figure(max(abs(low), abs(high)), 2))
    axes.set_xticks(range(len(cells)), names, rotation=90)
    axes.grid(False, axis="x")
    axes.set_xlabel("falling ← rate of the input, up to (V/s) → rising")
    _finish(axes, cells, "rate, signed")


def _names(axes: Axes, cells: Sequence[Where], title: str) -> None:
    """Draw horizontal bars, each with its name."""
    for at, cell in enumerate(cells):
        axes.barh(at, 100 * cell.share, height=0.8, **_look(cell))
    axes.set_yticks(range(len(cells)), [shortened(cell.label, 16) for cell in cells])
    axes.invert_yaxis()
    axes.grid(False, axis="y")
    axes.set(xlim=(0, 105), xlabel="share (%)", title=title)


def _finish(axes: Axes, cells: Sequence[Where], title: str) -> None:
    axes.set(
        ylabel="share (%)",
        ylim=(0, 1.12 * max(max((100 * cell.share for cell in cells), default=0.0), 1.0)),
        title=title,
    )


def _look(cell: Where) -> dict[str, Any]:
    if cell.significance > SIGNIFICANT:
        return {"color": STRONG, "edgecolor": "#003a5c", "linewidth": 0.6}
    return {"color": "#e4edf4", "edgecolor": "#8aa5b8", "linewidth": 0.6}


def _loudest(mask: Signal, size: Signal, at_most: int = 500) -> Signal:
    """Thin out many lines: keep the largest of each of 500 groups."""
    k = np.flatnonzero(mask)
    if len(k) <= at_most:
        return mask
    kept = np.zeros(len(mask), dtype=bool)
    for group in np.array_split(k, at_most):
        kept[group[size[group].argmax()]] = True
    return kept
