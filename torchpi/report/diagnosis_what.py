"""What a diagnosis names: each effect beside its rivals, and what it adds to the motion."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from torchpi.diagnosis.diagnosis import Diagnosis, NamedEffect, Trace
from torchpi.report import style
from torchpi.report.diagnosis_style import (
    ADDED,
    BEFORE,
    FAINT,
    RECORDED,
    STRONG,
    draw_floor,
    plain_numbers,
    shortened,
    unit_of,
)
from torchpi.report.style import drawing, settle
from torchpi.report.traces import Signal, envelope


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
        draw_floor(error.axvline, diagnosis.noise_floor_um, unit)
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
            plain_numbers(axes, y=False)
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
            f"{shortened(trace.name)}, where {effect.name.replace('_', ' ')} is largest: recorded motion"
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


def _time_axis(t: Signal) -> tuple[Signal, str]:
    return (1e3 * t, "ms") if t[-1] - t[0] < 0.5 else (t, "s")
