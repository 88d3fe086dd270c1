"""Figures of the gain from a diagnosis: errors before and after over time, voltage, frequency; the rest."""

import numpy as np
from matplotlib.figure import Figure

from torchpi.diagnosis.diagnosis import Diagnosis, Trace
from torchpi.diagnosis.say import WORTH_A_SENTENCE, spoken
from torchpi.report import style
from torchpi.report.diagnosis_style import (
    AFTER,
    BEFORE,
    HELD_OUT,
    RECORDED,
    SILENT_NM,
    STRONG,
    draw_floor,
    log_if_wide,
    plain_numbers,
    shortened,
    unit_of,
)
from torchpi.report.style import WIDTH_IN, canvas
from torchpi.report.traces import Signal, envelope, stretches, thinned

HELDOUT_TRACES = 4
"""Number of recordings whose traces are drawn."""
TOGETHER = "several together"
TELEPHONE_IN = 0.7 * WIDTH_IN
"""Width of a figure that fits a phone screen, with text as large as that of other figures there."""


def errors_figure(diagnosis: Diagnosis) -> Figure:
    """Draw the held-out errors of the three stages, and the noise floor if it was measured."""
    fits = {
        "nominal, as given": diagnosis.nominal,
        "retuned": diagnosis.retuned,
        "with what was missing": diagnosis.augmented,
    }
    unit = unit_of(max(fit.heldout_rms_um for fit in fits.values()))
    with canvas(1.75, TELEPHONE_IN) as figure:
        axes = figure.subplots()
        fills = (("#cccccc", "//"), (BEFORE["color"], ""), (AFTER["color"], ""))
        values = [unit.per_um * fit.heldout_rms_um for fit in fits.values()]
        for at, (value, (color, hatch)) in enumerate(zip(values, fills, strict=True)):
            axes.barh(at, value, color=color, hatch=hatch, edgecolor="#333333", linewidth=0.6, height=0.62)
            axes.annotate(
                f"{value:.3g}", (value, at), (4, 0), textcoords="offset points", va="center", fontsize=8
            )
        draw_floor(axes.axvline, diagnosis.noise_floor_um, unit)
        axes.set_yticks(range(3), list(fits))
        axes.invert_yaxis()
        axes.grid(False, axis="y")
        log_if_wide(axes, [*values, unit.per_um * (diagnosis.noise_floor_um or 0.0)])
        axes.set(xlabel=f"held-out error, rms ({unit.name})", title="three stages, the same data")
        if diagnosis.noise_floor_um is not None:
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)
    return figure


def heldout_figure(diagnosis: Diagnosis) -> Figure:
    """Draw the motion of each recording and its residual before and after; held-out samples are shaded."""
    traces = diagnosis.traces[:HELDOUT_TRACES]
    unit = unit_of(max(largest_um(trace) for trace in traces))
    with canvas(0.5 + 1.95 * len(traces)) as figure:
        rows = figure.subplots(2 * len(traces), 1, height_ratios=(0.55, 1.0) * len(traces))
        for trace, motion, residual in zip(traces, rows[::2], rows[1::2], strict=True):
            motion.plot(*envelope(trace.t, trace.y), **{**RECORDED, "linewidth": 0.8})
            motion.set(ylabel="y (µm)", title=shortened(trace.name))
            motion.tick_params(labelbottom=False)
            residual.plot(
                *envelope(trace.t, unit.per_um * trace.residual_retuned),
                label="before: retuned",
                **{**BEFORE, "linewidth": 0.7},
            )
            residual.plot(
                *envelope(trace.t, unit.per_um * trace.residual_augmented),
                label="after: augmented",
                **{**AFTER, "linewidth": 0.7},
            )
            floors = () if diagnosis.noise_floor_um is None else (-1, 1)
            for sign in floors:
                residual.axhline(
                    sign * unit.per_um * (diagnosis.noise_floor_um or 0.0),
                    label="noise floor, ± rms" if sign > 0 else None,
                    **{**style.LIMIT, "color": "#000000"},
                )
            residual.set_ylim(*(sign * unit.per_um * largest_um(trace) for sign in (-1, 1)))
            residual.set(ylabel=f"residual ({unit.name})", xlabel="time (s)")
            for axes in (motion, residual):
                axes.set_xlim(trace.t[0], trace.t[-1])
                for number, (start, stop) in enumerate(stretches(trace.heldout)):
                    axes.axvspan(
                        trace.t[start],
                        trace.t[stop - 1],
                        label="held out" if not number else None,
                        **HELD_OUT,
                    )
        rows[1].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, borderaxespad=0.2)
    return figure


def loop_figure(diagnosis: Diagnosis) -> Figure:
    """Draw the recording with the largest residual: its loop less a line, and the residual over voltage."""
    trace = max(diagnosis.traces, key=lambda one: float((one.residual_retuned**2).mean()))
    unit = unit_of(largest_um(trace))
    with canvas(3.1) as figure:
        loop, residual = figure.subplots(1, 2)
        slope, offset = np.polyfit(trace.u, trace.y, 1) if np.ptp(trace.u) else (0.0, trace.y.mean())
        bent = trace.y - slope * trace.u - offset
        bent_unit = unit_of(float(np.abs(bent).max()))
        loop.plot(*thinned(trace.u, bent_unit.per_um * bent), **{**RECORDED, "linewidth": 0.5})
        loop.set(
            ylabel=f"y minus a straight line ({bent_unit.name})",
            title=f"{shortened(trace.name)}: loop, recorded",
        )
        for e, label, look in (
            (trace.residual_retuned, "before: retuned", BEFORE),
            (trace.residual_augmented, "after: augmented", AFTER),
        ):
            k = np.linspace(0, len(e) - 1, min(len(e), 1_000)).astype(int)
            residual.plot(
                trace.u[k], unit.per_um * e[k], ls="", marker=".", ms=1.6, color=look["color"], label=label
            )
        residual.set_ylim(*(sign * unit.per_um * largest_um(trace) for sign in (-1, 1)))
        residual.set(ylabel=f"residual ({unit.name})", title="residual against voltage")
        residual.legend(loc="best", markerscale=5, handletextpad=0.2)
        for axes in (loop, residual):
            axes.set_xlabel("voltage u (V)")
    return figure


def spectrum_figure(diagnosis: Diagnosis) -> Figure:
    """Draw the held-out residual over frequency, before and after, and white noise of the measured size."""
    traces = diagnosis.traces[:4]
    columns, lines = min(len(traces), 2), -(-len(traces) // 2)
    with canvas(0.4 + 2.5 * lines) as figure:
        panels = figure.subplots(lines, columns, squeeze=False, sharey=True).ravel()
        for axes, trace in zip(panels, traces, strict=False):
            for e, label, look in (
                (trace.residual_retuned, "before: retuned", BEFORE),
                (trace.residual_augmented, "after: augmented", AFTER),
            ):
                axes.plot(*_heldout_density(trace, e), label=label, **look)
            if diagnosis.noise_floor_um is not None:
                floor = 1e3 * diagnosis.noise_floor_um * np.sqrt(2 / trace.fs_hz)
                axes.axhline(floor, label="noise floor", **{**style.LIMIT, "color": "#000000"})
            axes.set(xscale="log", yscale="log")
            plain_numbers(axes)
            axes.set(xlabel="frequency (Hz)", ylabel="residual (nm per √Hz)", title=shortened(trace.name))
        for axes in panels[len(traces) :]:
            axes.set_visible(False)
        panels[0].legend(loc="best")
    return figure


def remains_figure(diagnosis: Diagnosis) -> Figure:
    """Draw how the mismatch above the noise divides: each effect, several effects together, unexplained."""
    shares = {spoken(effect.name): effect.share for effect in diagnosis.effects}
    if diagnosis.joint_share >= WORTH_A_SENTENCE:
        shares[TOGETHER] = diagnosis.joint_share
    if diagnosis.noise_floor_um is not None or not shares:
        shares["unexplained"] = diagnosis.unexplained_share
    with canvas(0.75 + 0.27 * len(shares)) as figure:
        axes = figure.subplots()
        for at, (name, share) in enumerate(shares.items()):
            rest, joint = name == "unexplained", name == TOGETHER
            axes.barh(
                at,
                100 * share,
                height=0.66,
                edgecolor="#333333",
                linewidth=0.6,
                color="#eeeeee" if rest else STRONG,
                hatch="xx" if rest else "//" if joint else "",
            )
            axes.annotate(
                f"{100 * share:.3g} %",
                (100 * share, at),
                (4, 0),
                textcoords="offset points",
                va="center",
                fontsize=8,
            )
        axes.set_yticks(range(len(shares)), list(shares))
        axes.invert_yaxis()
        axes.set_xlim(0, 108)
        axes.grid(False, axis="y")
        over = "" if diagnosis.noise_floor_um is None else " above the noise floor"
        axes.set_xlabel(f"share of the squared mismatch{over} (%)")
    return figure


def next_figure(diagnosis: Diagnosis) -> Figure:
    """Draw the voltage to play next."""
    t, u = diagnosis.next_excitation
    with canvas(1.8) as figure:
        axes = figure.subplots()
        axes.plot(*envelope(t, u), **{**style.TORCHPI, "linewidth": 0.8})
        axes.set(xlim=(t[0], t[-1]), xlabel="time (s)", ylabel="voltage u (V)", title="next recording")
    return figure


def largest_um(trace: Trace) -> float:
    """Return the limit of a residual plot: the held-out maximum, or the 0.999 quantile of all if larger.

    A start-up transient, which no model describes, would otherwise flatten the rest.
    """
    both = np.abs([trace.residual_retuned, trace.residual_augmented])
    held = float(both[:, trace.heldout].max()) if trace.heldout.any() else 0.0
    return 1.1 * max(held, float(np.quantile(both, 0.999)), 1e-9)


def _heldout_density(trace: Trace, e: Signal) -> tuple[Signal, Signal]:
    """Return the amplitude density of held-out stretches, nm per √Hz, in fine logarithmic bands."""
    runs = stretches(trace.heldout) or [(0, len(e))]
    length = min(stop - start for start, stop in runs)
    window = np.hanning(length + 2)[1:-1]
    scale = 2 / ((window**2).sum() * trace.fs_hz)
    pieces = [e[start : start + length] - e[start : start + length].mean() for start, _ in runs]
    power = np.mean([np.abs(np.fft.rfft(piece * window)) ** 2 * scale for piece in pieces], axis=0)[1:]
    f = np.fft.rfftfreq(length, 1 / trace.fs_hz)[1:]
    edges = np.unique(np.round(np.geomspace(1, len(f) + 1, 160)).astype(int)) - 1
    band = np.add.reduceat(power, edges[:-1]) / np.diff(edges)
    return np.sqrt(f[edges[:-1]] * f[edges[1:] - 1]), np.maximum(1e3 * np.sqrt(band), SILENT_NM)
