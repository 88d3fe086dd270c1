"""Shared by the figures of a diagnosis: units, colours and the format of numbers."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullFormatter

from torchpi.report import style

BEFORE: dict[str, Any] = {"color": "#E69F00", "linewidth": 1.0}
AFTER: dict[str, Any] = {"color": "#0072B2", "linewidth": 1.0}
RECORDED: dict[str, Any] = {"color": "#000000", "linewidth": 1.2}
ADDED: dict[str, Any] = {"color": "#D55E00", "linestyle": (0, (4, 1.5)), "linewidth": 1.6}
HELD_OUT: dict[str, Any] = {"color": "#000000", "alpha": 0.08, "linewidth": 0}
SILENT_NM = 1e-6
"""Least value drawn, in place of 0, which a logarithmic axis cannot show."""
FAINT, STRONG = "#b9d3e6", "#0072B2"


@dataclass(frozen=True)
class Unit:
    """Unit of residuals: nm if they are small, µm otherwise."""

    name: str
    per_um: float


def unit_of(largest_um: float) -> Unit:
    return Unit("nm", 1e3) if largest_um < 1.0 else Unit("µm", 1.0)


def draw_floor(draw: Any, noise_floor_um: float | None, unit: Unit) -> None:
    """Draw a line at the noise floor, if it was measured."""
    if noise_floor_um is None:
        return
    draw(
        unit.per_um * noise_floor_um,
        label="noise floor",
        **{**style.LIMIT, "color": "#000000", "linewidth": 1.2},
    )


def log_if_wide(axes: Axes, values: Sequence[float]) -> None:
    positive = [value for value in values if value > 0]
    if positive and max(positive) > 30 * min(positive):
        axes.set_xscale("log")
        axes.set_xlim(0.5 * min(positive), 2.5 * max(positive))
        plain_numbers(axes, y=False)
    else:
        axes.margins(x=0.12)


def plain_numbers(axes: Axes, x: bool = True, y: bool = True) -> None:
    """Label the axes with plain numbers instead of powers of ten."""
    for axis in ([axes.xaxis] if x else []) + ([axes.yaxis] if y else []):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.6g}".replace("-", "−")))
        axis.set_minor_formatter(NullFormatter())


def shortened(name: str, at_most: int = 28) -> str:
    return name if len(name) <= at_most else name[: at_most - 1] + "…"
