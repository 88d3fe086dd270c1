"""A common style for all figures: legible at column width, for colour-blind readers, and in grey."""

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation, LogLocator

# Okabe and Ito (2008). Lightness, dashes and width differ too, so that lines are distinct in grey print.
WANTED: dict[str, Any] = {"color": "#000000", "linestyle": (0, (1, 1.2)), "linewidth": 1.6}
TORCHPI: dict[str, Any] = {"color": "#0072B2", "linestyle": "-", "linewidth": 1.3}
WITHOUT: dict[str, Any] = {"color": "#E69F00", "linestyle": "-", "linewidth": 0.9}
OTHERS: tuple[dict[str, Any], ...] = (
    {"color": "#D55E00", "linestyle": (0, (4, 1.5)), "linewidth": 1.1},
    {"color": "#009E73", "linestyle": (0, (6, 1.5, 1, 1.5)), "linewidth": 1.1},
    {"color": "#CC79A7", "linestyle": (0, (2, 1.2)), "linewidth": 1.1},
    {"color": "#56B4E9", "linestyle": (0, (8, 2)), "linewidth": 1.1},
)
LIMIT: dict[str, Any] = {"color": "#555555", "linestyle": (0, (3, 2)), "linewidth": 0.9}
SHADE: dict[str, Any] = {"color": "#000000", "alpha": 0.06, "linewidth": 0}

WIDTH_IN = 7.2  # width of an A4 page within its margins

_RC: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.5,
    "axes.linewidth": 0.7,
    "axes.formatter.useoffset": False,
    "figure.dpi": 100,
    "figure.constrained_layout.use": True,
    "path.simplify": True,
    "path.simplify_threshold": 0.2,
    "svg.fonttype": "none",  # keeps text as text: small, searchable, readable by screen readers
    "svg.hashsalt": "torchpi",  # the same figure gives the same bytes
}


GROWS = 4
"""Number of heights that are tried."""
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class Powers(LogFormatterSciNotation):
    """Labels of a logarithmic axis as plain text, 10⁻³: as formulas they take longer than the drawing."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        plain: str = super().__call__(x, pos).removeprefix(r"$\mathdefault{").removesuffix("}$")
        plain = plain.replace(r"\times", "×")
        return re.sub(r"\^\{(-?\d+)\}", lambda power: power[1].translate(RAISED), plain)


@contextmanager
def drawing() -> Iterator[None]:
    """Apply the style while drawing or saving, without changing settings outside."""
    with matplotlib.rc_context(_RC):
        yield


@contextmanager
def canvas(height_in: float, width_in: float = WIDTH_IN) -> Iterator[Figure]:
    """Yield a figure and lay it out at the end, made taller if necessary; its layout is then fixed."""
    with drawing():
        figure = Figure(figsize=(width_in, height_in))
        yield figure
        for axes in figure.axes:
            for axis in (axes.xaxis, axes.yaxis):
                if isinstance(axis.get_major_formatter(), LogFormatterSciNotation):
                    axis.set_major_formatter(Powers())
                if isinstance(axis.get_minor_formatter(), LogFormatterSciNotation):
                    axis.set_minor_formatter(Powers())
                low, high = axis.get_view_interval()
                if isinstance(axis.get_minor_locator(), LogLocator) and high > 10 * low:
                    axis.set_minor_locator(LogLocator(subs=(2, 5)))  # the time to draw grows with every tick
        engine = figure.get_layout_engine()
        assert engine is not None  # the style enables one
        for _ in range(GROWS):
            try:
                with warnings.catch_warnings():
                    warnings.filterwarnings("error", message="constrained_layout not applied")
                    # Drawing without a renderer would also compute the layout, but costs the drawing too.
                    engine.execute(figure)
                break
            except UserWarning:  # labels and legends leave the axes no room
                figure.set_size_inches(figure.get_figwidth(), 1.25 * figure.get_figheight())
        figure.set_layout_engine("none")


def legend_above(axes: Axes, columns: int, **look: Any) -> None:
    """Place the legend above the right end of the axes."""
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, borderaxespad=0.2, **look)
