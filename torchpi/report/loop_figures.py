"""Figures of a loop result; each function takes the result and returns a matplotlib Figure."""

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from torchpi.loop.result import COMPENSATED, WITHOUT, WITHOUT_LOOK_AHEAD, LoopResult
from torchpi.report import style
from torchpi.report.style import canvas, legend_above
from torchpi.report.traces import envelope, readable, thinned


def trajectory_figure(result: LoopResult) -> Figure:
    """Draw motion and reference, and below the error of every drive, over a stretch short enough to read."""
    part = readable(result.yd)
    t, yd = result.t[part], result.yd[part]
    with canvas(4.6) as figure:
        motion, error = figure.subplots(2, 1, sharex=True, height_ratios=(1.15, 1))
        for key in (WITHOUT, COMPENSATED):
            drive = result.drives[key]
            motion.plot(*envelope(t, drive.y_true[part]), label=drive.label, **line_of(result, key))
        motion.plot(*envelope(t, yd), label="reference", **style.WANTED, zorder=4)
        motion.set(ylabel="displacement (µm)", title=f"{result.title}: motion")
        for key, drive in result.drives.items():
            error.plot(*envelope(t, drive.y_true[part] - yd), label=drive.label, **line_of(result, key))
        error.set(ylabel="error, y − reference (µm)", xlabel="time (s)", xlim=(t[0], t[-1]))
        for axes in (motion, error):
            _shade_loading(axes, result)
            legend_above(axes, 4, handlelength=2.2)
    return figure


def linearity_figure(result: LoopResult) -> Figure:
    """Draw the tracking error over displacement: before and after on one scale, and after on its own."""
    with canvas(3.4) as figure:
        both, alone = figure.subplots(1, 2)
        n = result.loading_samples if loading_s(result) is not None else 0
        for axes, keys in ((both, (WITHOUT, COMPENSATED)), (alone, (COMPENSATED,))):
            for key in keys:
                drive = result.drives[key]
                error_nm = 1e3 * (drive.y_true - result.yd)
                if n:
                    loading = "loading" if key == keys[-1] else None
                    until = slice(n + 1)
                    axes.plot(
                        *thinned(result.yd[until], error_nm[until]), color="#999999", lw=0.7, label=loading
                    )
                line = {**line_of(result, key), "linewidth": 0.8}
                axes.plot(*thinned(result.yd[n:], error_nm[n:]), label=drive.label, **line)
            axes.set(xlabel="reference (µm)", ylabel="error, y − reference (nm)")
            legend_above(axes, 3)
    return figure


def error_figure(result: LoopResult) -> Figure:
    """Draw the errors that the scale of the first figure hides, and a zoom on the largest of them."""
    with canvas(4.4) as figure:
        whole, zoom = figure.subplots(2, 1)
        start, stop = _worst_window(result)
        for key, drive in result.drives.items():
            if key in (WITHOUT, WITHOUT_LOOK_AHEAD):
                continue
            error_nm = 1e3 * (drive.y_true - result.yd)
            line = {**line_of(result, key), "linewidth": 0.9}
            whole.plot(*envelope(result.t, error_nm), label=drive.label, **line)
            zoom.plot(1e3 * result.t[start:stop], error_nm[start:stop], label=drive.label, **line)
        _shade_loading(whole, result)
        whole.axvspan(
            result.t[start], result.t[stop - 1], **{**style.SHADE, "color": "#0072B2", "alpha": 0.18}
        )
        whole.set(xlim=(0.0, result.t[-1]), title="error with compensation", xlabel="time (s)")
        zoom.set(
            xlim=(1e3 * result.t[start], 1e3 * result.t[stop - 1]),
            title="the marked stretch, around the largest steady error",
            xlabel="time (ms)",
        )
        for axes in (whole, zoom):
            axes.set_ylabel("error (nm)")
        legend_above(whole, 4, handlelength=2.2)
    return figure


def voltage_figure(result: LoopResult) -> Figure:
    """Draw the voltage written to the stage, and its limits."""
    with canvas(2.7) as figure:
        axes = figure.subplots()
        for key in (WITHOUT, COMPENSATED):
            drive = result.drives[key]
            axes.plot(*envelope(result.t, drive.u), label=drive.label, **line_of(result, key))
        for limit_v, label in ((result.min_voltage_v, "limits"), (result.max_voltage_v, None)):
            axes.axhline(limit_v, label=label, **style.LIMIT)
        axes.set(xlim=(0.0, result.t[-1]), xlabel="time (s)", ylabel="voltage u (V)", title="voltage applied")
        _shade_loading(axes, result)
        legend_above(axes, 4, handlelength=2.2)
    return figure


def latency_figure(result: LoopResult) -> Figure:
    """Draw the distribution of the compensator's step times, with the sample period marked."""
    latency = result.compensated.latency
    with canvas(2.9) as figure:
        axes = figure.subplots()
        axes.stairs(
            latency.histogram_counts,
            latency.histogram_edges_us,
            baseline=0.5,
            fill=True,
            color=style.TORCHPI["color"],
            alpha=0.85,
        )
        marks = (
            (latency.median_us, f"median {latency.median_us:.3g} µs", ":"),
            (latency.p99_us, f"99 % {latency.p99_us:.3g} µs", "-."),
            (latency.p999_us, f"99.9 % {latency.p999_us:.3g} µs", "--"),
        )
        for at_us, label, dashes in marks:
            axes.axvline(at_us, color="#000000", linestyle=dashes, linewidth=1.0, label=label)
        axes.axvline(
            latency.period_us,
            color="#D55E00",
            linewidth=2.2,
            label=f"sample period {latency.period_us:.4g} µs",
        )
        axes.set(xscale="log", yscale="log")
        axes.set_ylim(bottom=0.5)
        edges = latency.histogram_edges_us
        axes.set_xlim(0.8 * min(edges[0], latency.period_us), 1.4 * max(edges[-1], latency.period_us))
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.6g}"))
        axes.set(xlabel="time of one step (µs)", ylabel="steps")
        legend_above(axes, 4, handlelength=2.2)
    return figure


FIGURES: dict[str, Callable[[LoopResult], Figure]] = {
    "trajectory": trajectory_figure,
    "linearity": linearity_figure,
    "error": error_figure,
    "voltage": voltage_figure,
    "latency": latency_figure,
}
"""Figures by name, in the order of the page."""


def line_of(result: LoopResult, key: str) -> dict[str, Any]:
    """Return the line style of a drive, the same in every figure."""
    if key == COMPENSATED:
        return {**style.TORCHPI, "zorder": 3}
    if key == WITHOUT:
        return style.WITHOUT
    others = [other for other in result.drives if other not in (WITHOUT, COMPENSATED)]
    return style.OTHERS[others.index(key) % len(style.OTHERS)]


def loading_s(result: LoopResult) -> float | None:
    """Return the end of the shading of the loading, s; None if it would cover most of the picture."""
    if 0 < result.loading_samples <= len(result.t) / 2:
        return float(result.t[result.loading_samples])
    return None


def _shade_loading(axes: Axes, result: LoopResult) -> None:
    end = loading_s(result)
    if end is not None:
        axes.axvspan(0.0, end, **style.SHADE)
        axes.annotate(
            "loading",
            (end / 2, 0.0),
            (0, 2),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            ha="center",
            fontsize=8,
            color="#555555",
            annotation_clip=True,
        )


def _worst_window(result: LoopResult) -> tuple[int, int]:
    """Return a twentieth of the record around the compensator's largest steady error, (start, stop)."""
    n, e = result.loading_samples, np.abs(result.compensated.y_true - result.yd)
    middle, half = n + int(np.argmax(e[n:])), max(len(e) // 40, 5)
    start = min(max(middle - half, 0), max(len(e) - 2 * half, 0))
    return start, min(start + 2 * half, len(e))
