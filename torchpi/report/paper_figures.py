"""The figures of Qin et al. (2013), drawn from results with the same axes and panels, and further ones."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from torchpi.report import style
from torchpi.report.style import canvas, legend_above
from torchpi.report.traces import envelope, thinned

if TYPE_CHECKING:
    from torchpi.paper import items_model, items_stage

PAPER: dict[str, Any] = {"color": "#D55E00", "linestyle": "-", "linewidth": 1.0}
MEASURED: dict[str, Any] = {"color": "#000000", "linestyle": "-", "linewidth": 1.5, "alpha": 0.75}
DIAGONAL: dict[str, Any] = {**style.WANTED, "linewidth": 0.9}
PANELS = "abcd"


def fig3(result: "items_model.Fig3Result") -> Figure:
    """Draw (a) every play with its weight, (b) their sum."""
    with canvas(3.2) as figure:
        alone, total = figure.subplots(1, 2)
        weights = ("10", "−5", "−5/3", "−5/6", "−0.5")
        for number, (part, weight) in enumerate(zip(result.parts, weights, strict=True)):
            alone.plot(result.x, part, color=_RAMP[number], linewidth=1.2, label=f"{weight}")
        total.plot(result.x, result.total, **style.TORCHPI)
        alone.set_title("(a) weighted plays")
        alone.legend(title="weight", loc="upper center", alignment="left")
        total.set_title("(b) their sum: the loop of an inverse")
        for axes in (alone, total):
            axes.set_xlabel("input (–)")
        alone.set_ylabel("output (–)")
    return figure


def fig4(result: "items_model.Fig4Result") -> Figure:
    """Draw the polynomial and the dead zones over the stage's travel, and their difference."""
    of = result.curves
    with canvas(3.2) as figure:
        curves, apart = figure.subplots(1, 2, width_ratios=(1.2, 1))
        curves.plot(of.x, of.cubic, label=f"cubic, {of.cubic_numbers} numbers", **style.TORCHPI)
        label = f"six dead zones, {of.dead_zone_numbers} numbers"
        curves.plot(of.x, of.dead_zones, label=label, **style.OTHERS[0])
        curves.set_ylabel("S (–)")
        curves.legend(loc="upper left")
        apart.plot(of.x, 100 * (of.dead_zones - of.cubic) / np.ptp(of.cubic), **style.OTHERS[0])
        apart.set_ylabel("difference (% of range)")
        for axes, title in ((curves, "the two operators"), (apart, "their difference")):
            axes.set(title=title, xlabel="input (µm)")
    return figure


def fig5(result: "items_model.Fig5Result") -> Figure:
    """Draw the loop of the inverse without and with the polynomial of eq. 5."""
    with canvas(3.2) as figure:
        plain, bent = figure.subplots(1, 2)
        plain.plot(result.x, result.u_plain, **style.WITHOUT)
        plain.set_title("plays alone")
        bent.plot(result.x, result.u, **style.TORCHPI)
        bent.set_title("with S of eq. 5 before them")
        for axes in (plain, bent):
            axes.set_xlabel("input (–)")
        plain.set_ylabel("output (–)")
    return figure


def fig7(result: "items_model.Fig7Result") -> Figure:
    """Draw displacement over voltage, one loop per frequency."""
    with canvas(3.7, 0.62 * style.WIDTH_IN) as figure:
        axes = figure.subplots()
        for number, (hz, loop) in enumerate(result.loops.items()):
            axes.plot(
                *thinned(loop.u, loop.y),
                color=_RAMP[number % len(_RAMP)],
                linewidth=1.2,
                label=f"{hz} Hz, {loop.area:.3g} V µm",
            )
        axes.set(xlim=(0, 10), xlabel="input (V)", ylabel="output (µm)", title="loops of the plant")
        axes.legend(loc="upper left")
    return figure


def fig8(result: "items_model.Fig8Result") -> Figure:
    """Draw four panels of y over y_d, indirect and direct, with the 45° line."""
    with canvas(6.8) as figure:
        panels = figure.subplots(2, 2, sharex=True, sharey=True).flat
        for letter, axes, hz in zip(PANELS, panels, result.indirect, strict=False):
            axes.plot([0, 11], [0, 11], **DIAGONAL)
            indirect, direct = result.indirect[hz], result.direct[hz]
            label = f"indirect, {indirect.max_percent:.2g} %"
            axes.plot(*thinned(indirect.yd, indirect.y), label=label, **PAPER)
            label = f"torchpi, direct, {direct.max_percent:.2g} %"
            axes.plot(*thinned(direct.yd, direct.y), label=label, **style.TORCHPI)
            axes.set(title=f"({letter}) {hz} Hz", xlim=(0, 11), ylim=(0, 11), aspect="equal")
            axes.legend(loc="upper left", title="largest error", alignment="left")
        for axes in figure.axes[2:]:
            axes.set_xlabel("desired displacement $y_d$ (µm)")
        for axes in figure.axes[::2]:
            axes.set_ylabel("actual displacement $y$ (µm)")
    return figure


def fig8_errors(result: "items_model.Fig8Result") -> Figure:
    """Draw the errors over one cycle, which are too small to see in the four panels."""
    with canvas(4.2) as figure:
        panels = figure.subplots(2, 2, sharex=True).flat
        for axes, hz in zip(panels, result.indirect, strict=False):
            for one, line, label in (
                (result.indirect[hz], PAPER, "indirect"),
                (result.direct[hz], style.TORCHPI, "torchpi, direct"),
            ):
                cycle = np.linspace(0, 1, len(one.yd))
                axes.plot(*envelope(cycle, 100 * (one.y - one.yd) / 9), label=label, **line)
            axes.set(title=f"{hz} Hz", xlim=(0, 1))
        for axes in figure.axes[2:]:
            axes.set_xlabel("cycle (–)")
        for axes in figure.axes[::2]:
            axes.set_ylabel("error (% of 9 µm)")
        legend_above(figure.axes[1], 2)
    return figure


def fig10(result: "items_stage.Fig10Result") -> Figure:
    """Draw the voltage (a) over displacement and (b) over time, and the difference below."""
    of = result.figure
    with canvas(5.6) as figure:
        mosaic = figure.subplot_mosaic("ab;cc", width_ratios=(1, 1.35), height_ratios=(1.4, 1))
        loop, time, error = mosaic["a"], mosaic["b"], mosaic["c"]
        loop.plot(*thinned(of.y, of.u), label="ideal inversion (measured)", **MEASURED)
        loop.plot(*thinned(of.y, of.u_model), label="identified model", **PAPER)
        loop.set(xlabel="displacement $y$ (µm)", title="(a) loops")
        short = of.t <= 0.2
        time.plot(*envelope(of.t[short], of.u[short]), label="ideal inversion (measured)", **MEASURED)
        time.plot(*envelope(of.t[short], of.u_model[short]), label="identified model", **PAPER)
        time.set(title="(b) time plot", xlim=(0, of.t[short][-1]))
        legend_above(time, 1)
        error.plot(*envelope(of.t, of.u_model - of.u), **{**PAPER, "linewidth": 0.8})
        error.axvspan(0, of.loading_s, **style.SHADE)
        error.set(xlim=(0, of.t[-1]), title="model − measured (initial loading shaded)")
        for axes in (loop, time):
            axes.set_ylabel("voltage $u$ (V)")
        error.set_ylabel("error (V)")
        for axes in (time, error):
            axes.set_xlabel("time (s)")
    return figure


def fig12(result: "items_stage.Fig12Result") -> Figure:
    """Draw desired and actual displacement over time, (a) slow and (b) fast; (c) the errors of both."""
    with canvas(7.6) as figure:
        axes = list(figure.subplots(4, 1, height_ratios=(1.1, 1.1, 1, 1)))
        for letter, (name, panel), motion, error in zip(
            PANELS, result.panels.items(), axes[:2], axes[2:], strict=False
        ):
            shown = panel.t <= (2.0 if name == "slow" else 0.5)
            motion.plot(*envelope(panel.t[shown], panel.tracked["paper"].y[shown]), label=_OF_PAPER, **PAPER)
            ours = panel.tracked["torchpi"].y
            motion.plot(*envelope(panel.t[shown], ours[shown]), label="torchpi", **style.TORCHPI)
            motion.plot(*envelope(panel.t[shown], panel.yd[shown]), label="desired", **DIAGONAL)
            motion.set(
                xlim=(0, panel.t[shown][-1]),
                ylabel="displacement (µm)",
                title=f"({letter}) {name} trajectory",
            )
            for method, line in (("paper", PAPER), ("torchpi", style.TORCHPI)):
                trace = panel.tracked[method].y - panel.yd
                error.plot(*envelope(panel.t, trace), **{**line, "linewidth": 0.8})
            error.axvspan(0, panel.loading_s, **style.SHADE)
            error.set(
                xlim=(0, panel.t[-1]),
                ylabel="error (µm)",
                title=f"(c) tracking error, {name} (initial loading shaded)",
            )
        legend_above(axes[0], 3)
        for one in axes:
            one.set_xlabel("time (s)")
    return figure


def fig13(result: "items_stage.Fig13Result") -> Figure:
    """Draw actual over desired displacement, before and after, (a) slow and (b) fast."""
    with canvas(3.9) as figure:
        panels = figure.subplots(1, 2, sharex=True, sharey=True)
        for letter, axes, (name, panel) in zip(PANELS, panels, result.trajectories.items(), strict=False):
            start = int(np.searchsorted(panel.t, panel.loading_s))
            axes.plot([0, 8], [0, 8], **DIAGONAL)
            for method, line, label in (
                ("without", style.WITHOUT, "before"),
                ("torchpi", style.TORCHPI, "after"),
            ):
                trace = panel.tracked[method].y
                axes.plot(
                    *thinned(panel.yd[start:], trace[start:]), **{**line, "linewidth": 0.8}, label=label
                )
            axes.set(
                title=f"({letter}) {name} trajectory",
                xlabel="desired displacement $y_d$ (µm)",
                aspect="equal",
            )
        panels[0].set_ylabel("actual displacement $y$ (µm)")
        panels[0].legend(loc="upper left")
    return figure


def fig13_by_frequency(result: "items_stage.Fig13Result") -> Figure:
    """Draw loop width and nonlinearity over frequency, logarithmic, before and after."""
    with canvas(3.3) as figure:
        panels = figure.subplots(1, 2, sharex=True, sharey=True)
        for axes, key, title in zip(
            panels, ("width_percent", "nonlinearity_percent"), ("loop width", "nonlinearity"), strict=True
        ):
            for loops, line, label in (
                (result.before, style.WITHOUT, "before"),
                (result.after, style.TORCHPI, "after"),
            ):
                hz = [float(name) for name in loops]
                values = [getattr(loop, key) for loop in loops.values()]
                axes.plot(hz, values, marker="o", markersize=3.5, label=label, **line)
            axes.set(xscale="log", yscale="log")
            _plain_ticks(axes, hz)
            axes.set(title=title, xlabel="frequency (Hz)")
        panels[0].set_ylabel("% of range")
        panels[0].legend(loc="center left")
    return figure


def unseen(result: "items_stage.UnseenResult") -> Figure:
    """Draw the largest and rms error of either method for every random trajectory."""
    with canvas(3.0) as figure:
        axes = figure.subplots()
        for method, line, label in (("paper", PAPER, _OF_PAPER), ("torchpi", style.TORCHPI, "torchpi")):
            trials = result.trials[method]
            number = np.arange(1, len(trials) + 1)
            look = {"linestyle": "none", "marker": "o", "markersize": 5, "color": line["color"]}
            axes.plot(number, [one.error.max_percent for one in trials], label=f"{label}, max", **look)
            look = {**look, "markerfacecolor": "none"}
            axes.plot(number, [one.error.rms_percent for one in trials], label=f"{label}, rms", **look)
        axes.set_yscale("log")
        axes.xaxis.set_major_locator(FixedLocator(list(number)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.set(xlabel="trajectory (–)", ylabel="error (% of peak to peak)")
        axes.yaxis.set_major_locator(FixedLocator([0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20]))
        axes.yaxis.set_minor_locator(NullLocator())
        legend_above(axes, 4)
    return figure


def fast_trajectory(result: "items_stage.Fig12Result") -> Figure:
    """Draw only the fast panel of Fig. 12: motion and error of both methods."""
    panel = result.panels["fast"]
    with canvas(3.8) as figure:
        motion, error = figure.subplots(2, 1, sharex=True)
        motion.plot(*envelope(panel.t, panel.yd), label="desired", **DIAGONAL)
        for method, line, label in (("paper", PAPER, _OF_PAPER), ("torchpi", style.TORCHPI, "torchpi")):
            y = panel.tracked[method].y
            motion.plot(*envelope(panel.t, y), label=label, **line)
            error.plot(*envelope(panel.t, y - panel.yd), **{**line, "linewidth": 0.8})
        motion.set_ylabel("displacement (µm)")
        legend_above(motion, 3)
        error.set(xlabel="time (s)", ylabel="error (µm)", xlim=(0, panel.t[-1]))
    return figure


FIGURES: Mapping[str, tuple[tuple[Callable[[Any], Figure], str], ...]] = {
    "fig3": ((fig3, "Fig. 3: plays with negative weights make the loop of an inverse."),),
    "fig4": ((fig4, "Fig. 4: a cubic against six one-sided dead zones."),),
    "fig5": ((fig5, "Fig. 5: the loop of the inverse, without and with the polynomial."),),
    "fig7": ((fig7, "Fig. 7: the loop at 1, 5, 10, 50 and 100 Hz."),),
    "fig8": (
        (fig8, "Fig. 8: actual over desired displacement, last cycle; the dotted line is 45°."),
        (fig8_errors, "The same errors over the last cycle."),
    ),
    "fig10": ((fig10, "Fig. 10: the ideal inversion and the identified model on the record of eq. 13."),),
    "fig12": ((fig12, "Fig. 12: tracking with the paper's method and with torchpi, true displacement."),),
    "fig13": (
        (fig13, "Fig. 13: actual over desired displacement after the initial loading, before and after."),
        (fig13_by_frequency, "Loop width and nonlinearity of sines over 1 … 7 µm."),
    ),
    "unseen": ((unseen, "Largest and rms errors on trajectories that were not used for tuning."),),
}
"""Drawing functions and captions by item."""

_OF_PAPER = "the paper's method"
_RAMP = ("#56B4E9", "#0072B2", "#009E73", "#E69F00", "#D55E00")


def _plain_ticks(axes: Axes, hz: list[float]) -> None:
    axes.xaxis.set_major_locator(FixedLocator(hz))
    axes.xaxis.set_minor_locator(NullLocator())
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
