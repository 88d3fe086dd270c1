"""Data for `linked.js`, which draws traces on a common time axis to zoom into and read values from.

Without scripts, and in print, a static figure is shown in their place.
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
"""Limit for all linked traces of a page: about 0.9 MB, as much again as its figures."""
COLUMNS = (60, 800)
"""Least and most columns of a trace; the highest and the lowest sample of each column are kept."""
DIGITS = 5
"""Digits of a value, relative to the range of its curve."""


@dataclass(frozen=True)
class Curve:
    """A line with its Matplotlib style; if `shown` is false, it appears after a click on its name."""

    label: str
    values: Signal  # (time,)
    look: Mapping[str, Any]
    shown: bool = True


@dataclass(frozen=True)
class Panel:
    """Curves that share one vertical axis."""

    label: str
    unit: str
    curves: tuple[Curve, ...]
    share: float = 1.0  # share of the height


@dataclass(frozen=True)
class Linked:
    """Panels over a common time axis, s; stretches of it are shaded and named."""

    t: Signal  # (time,), s
    panels: tuple[Panel, ...]
    shaded: tuple[tuple[float, float], ...] = ()
    shade_label: str = ""
    title: str = ""
    view: tuple[float, float] | None = None
    """The stretch shown first, s; None for the whole."""

    @property
    def curves(self) -> list[Curve]:
        return [curve for panel in self.panels for curve in panel.curves]


def linked_markup(traces: Sequence[Linked], figure: Markup, most: float = MOST_NUMBERS) -> Markup:
    """Return the markup of the figure, with the data that the script draws in its place.

    Args:
        traces: The traces that the figure shows.
        figure: SVG of the figure.
        most: Largest number of values in all traces together.
    """
    texts = [_script(one, most / len(traces)) for one in traces]
    return Markup(f'<div class="linked">{"".join(texts)}\n<div class="still">{figure}</div></div>')


def _script(linked: Linked, most_numbers: float) -> str:
    # Each curve keeps its own extremes, and also a sample wherever another curve keeps one.
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
    # Escaped, because nothing inside a script element may look like its end tag.
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
        "Drag across a stretch to zoom in, double-click to see the whole, click on a name to hide or show "
        "its curve."
    ]
    if kept < len(linked.t):
        parts.append(f"{kept:,} of {len(linked.t):,} samples are drawn; all peaks are kept.")
    if linked.view is not None:
        begin_s, end_s = linked.view
        parts.append(f"Shown first: {end_s - begin_s:.2g} s of {linked.t[-1] - linked.t[0]:.3g} s.")
    if linked.shaded:
        parts.append(f"Shaded: {linked.shade_label}.")
    return " ".join(parts)
