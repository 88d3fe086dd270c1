"""Traces with one time axis, to zoom into and to read values from: the data that `linked.js` draws.

Without a script, and in print, the figure that stands in their place is shown.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from torchpi.report.traces import Signal, extremes

MOST_NUMBERS = 150_000
"""On a page, in all its linked traces: about 0.9 MB, beside figures of as much."""
COLUMNS = (60, 800)
"""Least and most columns of a trace, of each of which the highest and the lowest sample stay."""
DIGITS = 5
"""Of a value, counted from the range of its curve."""


@dataclass(frozen=True)
class Curve:
    """A line in its look of Matplotlib; one that is not shown waits for a click on its name."""

    label: str
    values: Signal  # (time,)
    look: Mapping[str, Any]
    shown: bool = True


@dataclass(frozen=True)
class Panel:
    """Curves over one axis."""

    label: str
    unit: str
    curves: tuple[Curve, ...]
    share: float = 1.0  # of the height


@dataclass(frozen=True)
class Linked:
    """Panels over one time axis, s; stretches of it are shaded and named."""

    t: Signal  # (time,), s
    panels: tuple[Panel, ...]
    shaded: tuple[tuple[float, float], ...] = ()
    shade_label: str = ""
    title: str = ""
    view: tuple[float, float] | None = None
    """The stretch that is shown first, s; None for the whole."""

    @property
    def curves(self) -> list[Curve]:
        return [curve for panel in self.panels for curve in panel.curves]


def linked_markup(traces: Sequence[Linked], figure: Markup, most: float = MOST_NUMBERS) -> Markup:
    """The figure, and beside it what the script draws in its place.

    Args:
        traces: What the figure shows.
        figure: Its SVG.
        most: Numbers that they may hold together.
    """
    texts = [_script(one, most / len(traces)) for one in traces]
    return Markup(f'<div class="linked">{"".join(texts)}\n<div class="still">{figure}</div></div>')


def _script(linked: Linked, most_numbers: float) -> str:
    # Each curve keeps its own extremes, and has a value wherever another one does.
    curves = linked.curves
    fewest, most = COLUMNS
    columns = int(most_numbers / (2 * len(curves) * (len(curves) + 1)))
    columns = min(max(columns, fewest), most)
    parts = [slice(0, len(linked.t))]
    if linked.view is not None:
        columns //= 2
        parts.append(slice(*np.searchsorted(linked.t, linked.view)))
    kept = np.unique(
        np.concatenate(
            [part.start + extremes(curve.values[part], columns) for curve in curves for part in parts]
        )
    )
    step_s = float(np.median(np.diff(linked.t))) if len(linked.t) > 1 else 1.0
    content = {
        "title": linked.title,
        "t": _rounded(linked.t[kept], 0.01 * step_s),
        "shaded": [list(one) for one in linked.shaded],
        "view": linked.view or (float(linked.t[0]), float(linked.t[-1])),
        "note": _note(linked, len(kept)),
        "panels": [
            {
                "label": panel.label,
                "unit": panel.unit,
                "share": panel.share,
                "curves": [_curve(curve, kept) for curve in panel.curves],
            }
            for panel in linked.panels
        ],
    }
    # Nothing in a script may look like its end.
    text = json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace(
        "<", "\\u003c"
    )
    return f'<script type="application/json" class="linked-data">{text}</script>'


def _curve(curve: Curve, kept: np.ndarray) -> dict[str, Any]:
    values = curve.values
    width = float(curve.look.get("linewidth", 1.0))
    style = curve.look.get("linestyle", "-")
    dashes = style[1] if isinstance(style, tuple) else ()
    return {
        "label": curve.label,
        "color": str(curve.look["color"]),
        "width": round(1.2 * width, 2),
        "dash": [round(2.4 * width * one, 1) for one in dashes],
        "shown": curve.shown,
        "values": _rounded(values[kept], 10.0**-DIGITS * max(float(np.ptp(values)), 1e-12)),
    }


def _rounded(values: Signal, to: float) -> list[float]:
    rounded: list[float] = np.round(values, max(-math.floor(math.log10(to)), 0)).tolist()
    return rounded


def _note(linked: Linked, kept: int) -> str:
    parts = [
        "Drag over a stretch to zoom in, double-click for the whole, click on a name to hide or show it."
    ]
    if kept < len(linked.t):
        parts.append(f"{kept:,} of {len(linked.t):,} samples are drawn; none of the peaks is left out.")
    if linked.view is not None:
        begin_s, end_s = linked.view
        parts.append(f"Shown first: {end_s - begin_s:.2g} s of {linked.t[-1] - linked.t[0]:.3g} s.")
    if linked.shaded:
        parts.append(f"Shaded: {linked.shade_label}.")
    return " ".join(parts)
