"""Figures of the named effects: each effect beside its rivals, and what it adds to the motion."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from torchpi.diagnosis.diagnosis import Diagnosis, NamedEffect, Trace
from torchpi.diagnosis.say import spoken
from torchpi.report import words
from torchpi.report.diagnosis_style import (
    ADDED,
    BEFORE,
    FAINT,
    RECORDED,
    STRONG,
    plain_numbers,
    shortened,
    unit_of,
)
from torchpi.report.diagnosis_words import spoken_rivals
from torchpi.report.style import canvas
from torchpi.report.traces import Signal, envelope


def rivals_figure(effect: NamedEffect) -> Figure:
    """Draw the log predictive density lost with each rival in place of the effect, and the probabilities."""
    rivals = effect.rivals[:8]
    names = [spoken(effect.name), *spoken_rivals(rivals)]
    lost = [0.0, *(rival.loses_nats for rival in rivals)]
    chances = [100 * effect.probability, *(100 * rival.probability for rival in rivals)]
    with canvas(1.15 + 0.24 * len(names)) as figure:
        density, probability = figure.subplots(1, 2, sharey=True)
        for at in range(len(names)):
            alternative = at > 0 and rivals[at - 1].name in effect.alternatives
            look = {
                "color": STRONG if at == 0 else FAINT if alternative else "#d5d5d5",
                "hatch": "" if at == 0 else "..." if alternative else "//",
                "edgecolor": "#333333" if at == 0 else "#777777",
                "linewidth": 0.6,
                "height": 0.66,
            }
            for axes, value in ((density, lost[at]), (probability, chances[at])):
                axes.barh(at, value, **look)
                axes.annotate(
                    words.figure(value, 2),
                    (max(value, 0.0), at),
                    (3, 0),
                    textcoords="offset points",
                    va="center",
                    fontsize=8,
                )
        density.set_yticks(range(len(names)), names)
        density.invert_yaxis()
        density.set(xlabel="log predictive density lost (nats)", title="loss with each in the effect's place")
        probability.set(xlabel="probability (%)", xlim=(0, 118), title="probability")
        density.margins(x=0.16)
        density.xaxis.set_major_locator(MaxNLocator(4))
        plain_numbers(density, y=False)
        for axes in (density, probability):
            axes.grid(False, axis="y")
    return figure


def signature_figure(effect: NamedEffect, diagnosis: Diagnosis) -> Figure:
    """Draw what the effect adds to the displacement, where it adds most, against the retuned residual."""
    trace, start, stop = _largest(effect.name, diagnosis.traces)
    inside = slice(start, stop)
    added, left = trace.signatures[effect.name][inside], trace.residual_retuned[inside]
    unit = unit_of(float(max(np.abs(added).max(), np.abs(left).max())))
    t, time_unit = _time_axis(trace.t[inside])
    with canvas(3.5) as figure:
        motion, residual = figure.subplots(2, 1, sharex=True, height_ratios=(0.65, 1.35))
        motion.plot(*envelope(t, trace.y[inside]), **RECORDED)
        motion.set(
            ylabel="y (µm)",
            title=f"{shortened(trace.name)}, where {spoken(effect.name)} is largest: recorded motion",
        )
        residual.plot(
            *envelope(t, unit.per_um * left), label="recorded − retuned stage", **{**BEFORE, "linewidth": 0.8}
        )
        residual.plot(*envelope(t, unit.per_um * added), label=f"{spoken(effect.name)} adds", **ADDED)
        residual.axhline(0.0, color="#000000", linewidth=0.5)
        residual.set(ylabel=f"displacement ({unit.name})", xlabel=f"time ({time_unit})", xlim=(t[0], t[-1]))
        residual.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.2)
    return figure


def _largest(name: str, traces: Sequence[Trace]) -> tuple[Trace, int, int]:
    """Return the recording and the stretch, a twelfth of it long, in which the effect adds most."""
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
