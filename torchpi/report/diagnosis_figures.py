"""Figures of a diagnosis: each function takes the result and returns a matplotlib Figure."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

from torchpi.diagnosis.diagnosis import Diagnosis, NamedEffect, Trace, Where
from torchpi.diagnosis.locate import SIGNIFICANT
from torchpi.diagnosis.multisine import Parts, all_parts
from torchpi.report import style, words
from torchpi.report.style import drawing, settle
from torchpi.report.traces import Signal, envelope, thinned

BEFORE: dict[str, Any] = {"color": "#E69F00", "linewidth": 1.0}
AFTER: dict[str, Any] = {"color": "#0072B2", "linewidth": 1.0}
RECORDED: dict[str, Any] = {"color": "#000000", "linewidth": 1.2}
ADDED: dict[str, Any] = {"color": "#D55E00", "linestyle": (0, (4, 1.5)), "linewidth": 1.6}
HELD_OUT: dict[str, Any] = {"color": "#000000", "alpha": 0.08, "linewidth": 0}
PERIODIC = 2
"""Stretches with a periodic input that are drawn, the longest; a table has them all."""
SILENT_NM = 1e-6
"""Drawn in the place of nothing, which no logarithm shows."""
FAINT, STRONG = "#b9d3e6", "#0072B2"


@dataclass(frozen=True)
class Unit:
    """Residuals in nm where they are small, in µm otherwise."""

    name: str
    per_um: float


def unit_of(largest_um: float) -> Unit:
    return Unit("nm", 1e3) if largest_um < 1.0 else Unit("µm", 1.0)


def diagnosis_figures(diagnosis: Diagnosis) -> dict[str, Figure]:
    """Every figure of the diagnosis by name, as the page and TensorBoard show them."""
    figures = {"errors": errors_figure(diagnosis), "where": where_figure(diagnosis.where)}
    longest = sorted(all_parts(diagnosis.traces), key=lambda one: -one.period_s * one.periods)
    for number, parts in enumerate(longest[:PERIODIC], start=1):
        figures[f"multisine_{number}"] = multisine_figure(parts)
    for effect in diagnosis.effects:
        if effect.rivals:  # a converter's lattice is seen, and has none
            figures[f"rivals_{effect.name}"] = rivals_figure(effect, diagnosis)
        if any(effect.name in trace.signatures for trace in diagnosis.traces):
            figures[f"signature_{effect.name}"] = signature_figure(effect, diagnosis)
    if diagnosis.traces:
        figures["heldout"] = heldout_figure(diagnosis)
        figures["loop"] = loop_figure(diagnosis)
        figures["spectrum"] = spectrum_figure(diagnosis)
    figures["remains"] = remains_figure(diagnosis)
    if len(diagnosis.next_excitation[0]):
        figures["next_excitation"] = next_figure(diagnosis)
    return figures


def errors_figure(diagnosis: Diagnosis) -> Figure:
    """Errors of the three stages on held-out samples, and the floor below which nothing can be told."""
    fits = {
        "nominal, as given": diagnosis.nominal,
        "retuned and grown": diagnosis.retuned,
        "with what was missing": diagnosis.augmented,
    }
    unit = unit_of(max(fit.heldout_rms_um for fit in fits.values()))
    with drawing():
        figure = Figure(figsize=(style.WIDTH_IN, 1.75))
        axes = figure.subplots()
        fills = (("#cccccc", "//"), (BEFORE["color"], ""), (AFTER["color"], ""))
        values = [unit.per_um * fit.heldout_rms_um for fit in fits.values()]
        for at, (value, (color, hatch)) in enumerate(zip(values, fills, strict=True)):
            axes.barh(at, value, color=color, hatch=hatch, edgecolor="#333333", linewidth=0.6, height=0.62)
            axes.annotate(
                f"{value:.3g}", (value, at), (4, 0), textcoords="offset points", va="center", fontsize=8
            )
        _floor(axes.axvline, diagnosis.noise_floor_um, unit)
        axes.set_yticks(range(3), list(fits))
        axes.invert_yaxis()
        axes.grid(False, axis="y")
        _log_if_wide(axes, [*values, unit.per_um * diagnosis.noise_floor_um])
        axes.set_xlabel(f"held-out error, rms ({unit.name})")
        axes.set_title("three stages on the same held-out data")
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)
        settle(figure)
    return figure


def where_figure(where: Sequence[Where]) -> Figure:
    """Share of each cell of the eight domains; cells that stand out from chance are dark."""
    with drawing():
        strips = _strips(where)
        figure = Figure(figsize=(style.WIDTH_IN, 6.2 + 0.3 * len(strips)))
        grid = figure.add_gridspec(5, 2, height_ratios=(0.62 + 0.3 * len(strips), 1.5, 1.5, 1.5, 1.5))
        _heat_strips(figure.add_subplot(grid[0, :]), strips)
        _bands(figure.add_subplot(grid[1, :]), _map(where, "frequency"), "frequency (Hz)", "frequency", True)
        _bands(
            figure.add_subplot(grid[2, 0]),
            _map(where, "displacement"),
            "displacement $y$ (µm)",
            "displacement",
        )
        signed = [cell for cell in where if cell.domain == "rate" and cell.label != "either way"]
        _signed_rate(figure.add_subplot(grid[2, 1]), signed)
        _bands(
            figure.add_subplot(grid[3, 0]),
            _map(where, "since_reversal"),
            "time since the input turned round (s)",
            "time since the last reversal",
            True,
        )
        size = [cell for cell in where if cell.domain == "rate" and cell.label == "either way"]
        _bands(figure.add_subplot(grid[3, 1]), size, "size of the input's rate (V/s)", "rate", True)
        _bands(
            figure.add_subplot(grid[4, 0]),
            _map(where, "amplitude"),
            "swing of the input, peak to peak (V)",
            "amplitude level",
        )
        both = grid[4, 1].subgridspec(1, 2, width_ratios=(1, 1.3))
        _names(figure.add_subplot(both[0]), _map(where, "direction"), "direction")
        _names(figure.add_subplot(both[1]), _map(where, "recording"), "recording")
        settle(figure)
    return figure


def multisine_figure(parts: Parts) -> Figure:
    """The residual's lines by kind: excited, even, odd; and the noise to be expected on each."""
    unit = unit_of(float(parts.amplitude_um.max()))
    marks: dict[str, tuple[str, dict[str, Any]]] = {
        "linear": ("excited", {"color": "#999999", "marker": "."}),
        "even": ("even, not excited", {"color": "#0072B2", "marker": "^"}),
        "odd": ("odd, not excited", {"color": "#D55E00", "marker": "s"}),
        "mains": ("on the mains, not excited", {"color": "#000000", "marker": "x"}),
    }
    highest = 3 * float(parts.hz[parts.kind == "linear"].max())
    shown = parts.hz <= highest
    with drawing():
        figure = Figure(figsize=(style.WIDTH_IN, 3.0))
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
        axes.set_ylim(
            max(0.2 * typical, SILENT_NM),
            max(10 * SILENT_NM, 2 * unit.per_um * float(parts.amplitude_um[shown].max())),
        )
        axes.set_xscale("log")
        axes.set_yscale("log")
        _plain(axes)
        axes.set_xlabel("frequency (Hz)")
        axes.set_ylabel(f"amplitude of the residual ({unit.name})")
        axes.set_title(f"{_short(parts.recording)}, from {parts.start_s:.3g} s: lines of the period")
        axes.legend(
            loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=5, handletextpad=0.3, columnspacing=1.2,
            markerscale=1.4,
        )  # fmt: skip
        settle(figure)
    return figure


def rivals_figure(effect: NamedEffect, diagnosis: Diagnosis) -> Figure:
    """Held-out error and evidence of the effect, beside what was tried in its place."""
    rivals = effect.rivals[:8]
    unit = unit_of(max(rival.heldout_rms_um for rival in rivals))
    names = [rival.name.replace("_", " ") for rival in rivals]
    same = {effect.name, *effect.alternatives}
    with drawing():
        figure = Figure(figsize=(style.WIDTH_IN, 1.15 + 0.24 * len(rivals)))
        error, evidence = figure.subplots(1, 2, sharey=True)
        errors = [unit.per_um * rival.heldout_rms_um for rival in rivals]
        for at, rival in enumerate(rivals):
            own = rival.name in own_names(effect)
            look = {
                "color": STRONG if own else FAINT if rival.name in same else "#d5d5d5",
                "hatch": "" if own else "..." if rival.name in same else "//",
                "edgecolor": "#333333" if own else "#777777",
                "linewidth": 0.6,
                "height": 0.66,
            }
            error.barh(at, errors[at], **look)
            evidence.barh(at, rival.evidence, **look)
            for axes, value, text in (
                (error, errors[at], f"{errors[at]:.3g}"),
                (evidence, rival.evidence, f"{rival.evidence:,.0f}".replace("-", "−")),
            ):
                axes.annotate(
                    text, (max(value, 0.0), at), (3, 0), textcoords="offset points", va="center", fontsize=8
                )
        _floor(error.axvline, diagnosis.noise_floor_um, unit)
        error.set_yticks(range(len(rivals)), names)
        error.invert_yaxis()
        error.set_xlabel(f"held-out error, rms ({unit.name}): less is better")
        evidence.set_xlabel("log-likelihood gained: more is better")
        error.set_title("held-out error")
        evidence.set_title("evidence")
        for axes in (error, evidence):
            axes.grid(False, axis="y")
            axes.margins(x=0.16)
            axes.xaxis.set_major_locator(MaxNLocator(4))
            _plain(axes, y=False)
        error.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)
        settle(figure)
    return figure


def own_names(effect: NamedEffect) -> set[str]:
    """What the effect is called among its rivals: its name, or its family's."""
    return {effect.name, *(one.value for one in effect.parameters if isinstance(one.value, str))}


def signature_figure(effect: NamedEffect, diagnosis: Diagnosis) -> Figure:
    """What the effect adds to the displacement, where it adds most, against what the retuned stage leaves."""
    trace, start, stop = _largest(effect.name, diagnosis.traces)
    inside = slice(start, stop)
    added, left = trace.signatures[effect.name][inside], trace.residual_retuned[inside]
    unit = unit_of(float(max(np.abs(added).max(), np.abs(left).max())))
    t, time_unit = _time_axis(trace.t[inside])
    with drawing():
        figure = Figure(figsize=(style.WIDTH_IN, 3.5))
        motion, residual = figure.subplots(2, 1, sharex=True, height_ratios=(0.65, 1.35))
        motion.plot(*envelope(t, trace.y[inside]), **RECORDED)
        motion.set_ylabel("$y$ (µm)")
        motion.set_title(
            f"{_short(trace.name)}, where {effect.name.replace('_', ' ')} is largest: recorded motion"
        )
        residual.plot(
            *envelope(t, unit.per_um * left), label="recorded − retuned stage", **{**BEFORE, "linewidth": 0.8}
        )
        residual.plot(
            *envelope(t, unit.per_um * added), label=f"{effect.name.replace('_', ' ')} adds", **ADDED
        )
        residual.axhline(0.0, color="#000000", linewidth=0.5)
        residual.set_ylabel(f"displacement ({unit.name})")
        residual.set_xlabel(f"time ({time_unit})")
        residual.set_xlim(t[0], t[-1])
        residual.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.2)
        settle(figure)
    return figure


def heldout_figure(diagnosis: Diagnosis) -> Figure:
    """Every recording's motion, and its residual before and after; what was held out is shaded."""
    traces = diagnosis.traces[:4]
    unit = unit_of(max(largest_um(trace) for trace in traces))
    with drawing():
        figure = Figure(figsize=(style.WIDTH_IN, 0.5 + 1.95 * len(traces)))
        rows = figure.subplots(2 * len(traces), 1, height_ratios=(0.55, 1.0) * len(traces))
        for trace, motion, residual in zip(traces, rows[::2], rows[1::2], strict=True):
            motion.plot(*envelope(trace.t, trace.y), **{**RECORDED, "linewidth": 0.8})
            motion.set_ylabel("$y$ (µm)")
            motion.set_title(_short(trace.name))
            motion.tick_params(labelbottom=False)
            residual.plot(
                *envelope(trace.t, unit.per_um * trace.residual_retuned),
                label="before: retuned", **{**BEFORE, "linewidth": 0.7},
            )  # fmt: skip
            residual.plot(
                *envelope(trace.t, unit.per_um * trace.residual_augmented),
                label="after: augmented", **{**AFTER, "linewidth": 0.7},
            )  # fmt: skip
            for sign in (-1, 1):
                residual.axhline(
                    sign * unit.per_um * diagnosis.noise_floor_um,
                    label="noise floor, ± rms" if sign > 0 else None,
                    **{**style.LIMIT, "color": "#000000"},
                )
            residual.set_ylim(*(sign * unit.per_um * largest_um(trace) for sign in (-1, 1)))
            residual.set_ylabel(f"residual ({unit.name})")
            residual.set_xlabel("time (s)")
            for axes in (motion, residual):
                axes.set_xlim(trace.t[0], trace.t[-1])
                for number, (start, stop) in enumerate(_runs(trace.heldout)):
                    axes.axvspan(
                        trace.t[start],
                        trace.t[stop - 1],
                        label="held out" if not number else None,
                        **HELD_OUT,
                    )
        rows[1].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, borderaxespad=0.2)
        settle(figure)
    return figure


def largest_um(trace: Trace) -> float:
    """What a drawing of the residual must hold: all that was held out, and all but a thousandth of the rest.

    A start-up that no model has would else flatten everything.
    """
    both = np.abs([trace.residual_retuned, trace.residual_augmented])
    held = float(both[:, trace.heldout].max()) if trace.heldout.any() else 0.0
    return 1.1 * max(held, float(np.quantile(both, 0.999)), 1e-9)


def loop_figure(diagnosis: Diagnosis) -> Figure:
    """The loop of the recording with the largest residual, opened, and the residual over the voltage."""
    trace = max(diagnosis.traces, key=lambda one: float((one.residual_retuned**2).mean()))
    unit = unit_of(largest_um(trace))
    with drawing():
        figure = Figure(figsize=(style.WIDTH_IN, 3.1))
        loop, residual = figure.subplots(1, 2)
        slope, offset = np.polyfit(trace.u, trace.y, 1) if np.ptp(trace.u) else (0.0, trace.y.mean())
        bent = trace.y - slope * trace.u - offset
        bent_unit = unit_of(float(np.abs(bent).max()))
        loop.plot(*thinned(trace.u, bent_unit.per_um * bent), **{**RECORDED, "linewidth": 0.5})
        loop.set_ylabel(f"$y$ less a straight line ({bent_unit.name})")
        loop.set_title(f"{_short(trace.name)}: loop, recorded")
        for e, label, look in (
            (trace.residual_retuned, "before: retuned", BEFORE),
            (trace.residual_augmented, "after: augmented", AFTER),
        ):
            k = np.linspace(0, len(e) - 1, min(len(e), 2500)).astype(int)
            residual.plot(
                trace.u[k], unit.per_um * e[k], ls="", marker=".", ms=1.6, color=look["color"], label=label
            )
        residual.set_ylim(*(sign * unit.per_um * largest_um(trace) for sign in (-1, 1)))
        residual.set_ylabel(f"residual ({unit.name})")
        residual.set_title("residual over voltage")
        residual.legend(loc="best", markerscale=5, handletextpad=0.2)
        for axes in (loop, residual):
            axes.set_xlabel("voltage $u$ (V)")
        settle(figure)
    return figure


def spectrum_figure(diagnosis: Diagnosis) -> Figure:
    """Held-out residual over frequency, before and after, against a white floor of the noise's size."""
    with drawing():
        traces = diagnosis.traces[:4]
        columns = min(len(traces), 2)
        lines = -(-len(traces) // 2)
        figure = Figure(figsize=(style.WIDTH_IN, 0.4 + 2.5 * lines))
        panels = figure.subplots(lines, columns, squeeze=False, sharey=True).ravel()
        for axes, trace in zip(panels, traces, strict=False):
            for e, label, look in (
                (trace.residual_retuned, "before: retuned", BEFORE),
                (trace.residual_augmented, "after: augmented", AFTER),
            ):
                axes.plot(*_heldout_density(trace, e), label=label, **look)
            floor = 1e3 * diagnosis.noise_floor_um * np.sqrt(2 / trace.fs_hz)
            axes.axhline(floor, label="noise floor", **{**style.LIMIT, "color": "#000000"})
            axes.set_xscale("log")
            axes.set_yscale("log")
            _plain(axes)
            axes.set_xlabel("frequency (Hz)")
            axes.set_ylabel("residual (nm per √Hz)")
            axes.set_title(_short(trace.name))
        for axes in panels[len(traces) :]:
            axes.set_visible(False)
        panels[0].legend(loc="best")
        settle(figure)
    return figure


def remains_figure(diagnosis: Diagnosis) -> Figure:
    """The mismatch over the floor, shared out: each effect's, and what nothing explains."""
    shares = {effect.name.replace("_", " "): effect.share for effect in diagnosis.effects}
    shares["unexplained"] = diagnosis.unexplained_share
    with drawing():
        figure = Figure(figsize=(style.WIDTH_IN, 0.75 + 0.27 * len(shares)))
        axes = figure.subplots()
        for at, (name, share) in enumerate(shares.items()):
            rest = name == "unexplained"
            axes.barh(
                at, 100 * share, height=0.66, edgecolor="#333333", linewidth=0.6,
                color="#eeeeee" if rest else STRONG, hatch="xx" if rest else "",
            )  # fmt: skip
            axes.annotate(
                f"{100 * share:.3g} %", (100 * share, at), (4, 0),
                textcoords="offset points", va="center", fontsize=8,
            )  # fmt: skip
        axes.set_yticks(range(len(shares)), list(shares))
        axes.invert_yaxis()
        axes.set_xlim(0, 108)
        axes.grid(False, axis="y")
        axes.set_xlabel("share of the squared mismatch over the noise floor (%)")
        settle(figure)
    return figure


def next_figure(diagnosis: Diagnosis) -> Figure:
    """The voltage to play next."""
    t, u = diagnosis.next_excitation
    with drawing():
        figure = Figure(figsize=(style.WIDTH_IN, 1.8))
        axes = figure.subplots()
        axes.plot(*envelope(t, u), **{**style.TORCHPI, "linewidth": 0.8})
        axes.set_xlim(t[0], t[-1])
        axes.set_xlabel("time (s)")
        axes.set_ylabel("voltage $u$ (V)")
        axes.set_title("to be played next")
        settle(figure)
    return figure


def _map(where: Sequence[Where], domain: str) -> list[Where]:
    return [cell for cell in where if cell.domain == domain]


def _strips(where: Sequence[Where]) -> dict[str, list[Where]]:
    """Cells in seconds, recording by recording."""
    strips: dict[str, list[Where]] = {}
    for cell in where:
        if cell.domain == "time" and cell.unit == "s":
            strips.setdefault(cell.label, []).append(cell)
    return strips


def _heat_strips(axes: Axes, strips: dict[str, list[Where]]) -> None:
    """One strip a recording, as long as it lasted, dark where the residual lives."""
    most = max((cell.share for strip in strips.values() for cell in strip), default=0.0) or 1.0
    colours = matplotlib.colormaps["Blues"]
    longest = 0.0
    for at, strip in enumerate(strips.values()):
        first = strip[0].range[0]
        for cell in strip:
            low, high = cell.range[0] - first, cell.range[1] - first
            longest = max(longest, high)
            axes.barh(
                at, high - low, left=low, height=0.8, color=colours(cell.share / most),
                edgecolor="#777777", linewidth=0.5,
            )  # fmt: skip
            if cell.share >= 0.01:
                dark = cell.share > 0.55 * most
                axes.text(
                    (low + high) / 2, at, f"{100 * cell.share:.0f}", ha="center", va="center", fontsize=8,
                    color="#ffffff" if dark else "#000000",
                    fontweight="bold" if cell.significance > SIGNIFICANT else "normal",
                )  # fmt: skip
    axes.set_yticks(range(len(strips)), [_short(name) for name in strips])
    axes.set_xlim(0, longest or 1.0)
    axes.invert_yaxis()
    axes.grid(False)
    axes.set_xlabel("time in the recording (s)")
    axes.set_title("time: share in each twelfth of a recording (%)")


def _bands(axes: Axes, cells: Sequence[Where], label: str, title: str, log: bool = False) -> None:
    """Bars as wide as their cells."""
    lows, highs = [cell.range[0] for cell in cells], [cell.range[1] for cell in cells]
    if log and highs:
        # The cell that begins at 0 is drawn as wide as the one beside it.
        smallest = min(highs) * (min(highs) / highs[1] if len(highs) > 1 else 0.5)
        lows = [low if low > 0 else smallest for low in lows]
        axes.set_xscale("log")
    for low, high, cell in zip(lows, highs, cells, strict=True):
        axes.bar(low, 100 * cell.share, width=high - low, align="edge", **_look(cell))
    if log:
        _plain(axes, y=False)
    axes.set_xlabel(label)
    _finish(axes, cells, title)


def _signed_rate(axes: Axes, cells: Sequence[Where]) -> None:
    """Bars of one width, each with the end of its cell that is farther from 0."""
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
    """Lying bars, each with its name."""
    for at, cell in enumerate(cells):
        axes.barh(at, 100 * cell.share, height=0.8, **_look(cell))
    axes.set_yticks(range(len(cells)), [_short(cell.label, 16) for cell in cells])
    axes.invert_yaxis()
    axes.grid(False, axis="y")
    axes.set_xlim(0, 105)
    axes.set_xlabel("share (%)")
    axes.set_title(title)


def _finish(axes: Axes, cells: Sequence[Where], title: str) -> None:
    axes.set_ylabel("share (%)")
    axes.set_ylim(0, 1.12 * max(max((100 * cell.share for cell in cells), default=0.0), 1.0))
    axes.set_title(title)


def _look(cell: Where) -> dict[str, Any]:
    if cell.significance > SIGNIFICANT:
        return {"color": STRONG, "edgecolor": "#003a5c", "linewidth": 0.6}
    return {"color": "#e4edf4", "edgecolor": "#8aa5b8", "linewidth": 0.6}


def _largest(name: str, traces: Sequence[Trace]) -> tuple[Trace, int, int]:
    """The recording and the stretch in which the effect adds most, a twelfth of the recording long."""
    found = []
    for trace in traces:
        if name in trace.signatures:
            square = trace.signatures[name] ** 2
            length = min(max(len(square) // 12, 200), len(square))
            starts = np.arange(0, len(square) - length + 1, max(length // 4, 1))
            total = np.concatenate([[0.0], np.cumsum(square)])
            power = (total[starts + length] - total[starts]) / length
            start = int(starts[power.argmax()])
            found.append((float(power.max()), trace, start, start + length))
    return max(found, key=lambda one: one[0])[1:]


def _heldout_density(trace: Trace, e: Signal) -> tuple[Signal, Signal]:
    """Amplitude density of the held-out stretches, nm per √Hz, in fine logarithmic bands."""
    runs = _runs(trace.heldout) or [(0, len(e))]
    length = min(stop - start for start, stop in runs)
    window = np.hanning(length + 2)[1:-1]
    scale = 2 / ((window**2).sum() * trace.fs_hz)
    pieces = [e[start : start + length] - e[start : start + length].mean() for start, _ in runs]
    power = np.mean([np.abs(np.fft.rfft(piece * window)) ** 2 * scale for piece in pieces], axis=0)[1:]
    f = np.fft.rfftfreq(length, 1 / trace.fs_hz)[1:]
    edges = np.unique(np.round(np.geomspace(1, len(f) + 1, 160)).astype(int)) - 1
    band = np.add.reduceat(power, edges[:-1]) / np.diff(edges)
    return np.sqrt(f[edges[:-1]] * f[edges[1:] - 1]), np.maximum(1e3 * np.sqrt(band), SILENT_NM)


def _loudest(mask: Signal, size: Signal, at_most: int = 500) -> Signal:
    """Of many lines the largest of each of 500 groups."""
    k = np.flatnonzero(mask)
    if len(k) <= at_most:
        return mask
    kept = np.zeros(len(mask), dtype=bool)
    for group in np.array_split(k, at_most):
        kept[group[size[group].argmax()]] = True
    return kept


def _runs(mask: Signal) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    return [(int(start), int(stop)) for start, stop in zip(edges[::2], edges[1::2], strict=True)]


def _time_axis(t: Signal) -> tuple[Signal, str]:
    return (1e3 * t, "ms") if t[-1] - t[0] < 0.5 else (t, "s")


def _floor(draw: Any, noise_floor_um: float, unit: Unit) -> None:
    draw(
        unit.per_um * noise_floor_um,
        label="noise floor",
        **{**style.LIMIT, "color": "#000000", "linewidth": 1.2},
    )


def _log_if_wide(axes: Axes, values: Sequence[float]) -> None:
    positive = [value for value in values if value > 0]
    if positive and max(positive) > 30 * min(positive):
        axes.set_xscale("log")
        axes.set_xlim(0.5 * min(positive), 2.5 * max(positive))
        _plain(axes, y=False)
    else:
        axes.margins(x=0.12)


def _plain(axes: Axes, x: bool = True, y: bool = True) -> None:
    """Powers of ten as numbers."""
    for axis in ([axes.xaxis] if x else []) + ([axes.yaxis] if y else []):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.6g}".replace("-", "−")))
        axis.set_minor_formatter(NullFormatter())


def _short(name: str, at_most: int = 28) -> str:
    return name if len(name) <= at_most else name[: at_most - 1] + "…"
