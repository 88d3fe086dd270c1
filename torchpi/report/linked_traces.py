"""The linked traces of each page."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from torchpi.loop.result import COMPENSATED, WITHOUT, WITHOUT_LOOK_AHEAD, LoopResult
from torchpi.recordings.recording import Recording
from torchpi.report import style
from torchpi.report.diagnosis_style import AFTER, BEFORE, RECORDED, unit_of
from torchpi.report.linked import Curve, Linked, Panel
from torchpi.report.loop_figures import line_of, loading_s
from torchpi.report.traces import Signal, readable, stretches
from torchpi.report.training import RecordFit
from torchpi.report.training_figures import PREDICTED
from torchpi.report.training_figures import RECORDED as RECORDED_VOLTAGE

if TYPE_CHECKING:  # the pages of a loop and of a training need no diagnosis
    from torchpi.diagnosis.diagnosis import Trace

Signals = npt.NDArray[np.float64]  # shape: (time, axes)
VOLTAGE = {**style.TORCHPI, "linewidth": 0.9}


def loop_traces(result: LoopResult) -> Linked:
    """Return the reference and motion, the tracking error without and with compensation, and the voltage."""
    both = (WITHOUT, COMPENSATED)
    motions = [
        Curve(result.drives[key].label, result.drives[key].y_true, line_of(result, key)) for key in both
    ]
    reference = Curve("reference", result.yd, style.WANTED)
    errors = [
        Curve(
            drive.label,
            1e3 * (drive.y_true - result.yd),
            line_of(result, key),
            shown=key != WITHOUT_LOOK_AHEAD,
        )
        for key, drive in result.drives.items()
    ]
    voltages = [Curve(result.drives[key].label, result.drives[key].u, line_of(result, key)) for key in both]
    loaded_s = loading_s(result)
    return Linked(
        result.t,
        (
            Panel("displacement", "µm", (*motions, reference)),
            Panel("error", "nm", tuple(errors)),
            Panel("voltage", "V", tuple(voltages), share=0.8),
        ),
        shaded=((0.0, loaded_s),) if loaded_s is not None else (),
        shade_label="loading",
        view=_first_view(result.t, result.yd),
    )


def paper_traces(t: Signal, yd: Signal, paper: Signal, ours: Signal) -> Linked:
    """Return a trajectory, the motions of the paper's method and of torchpi, and both errors."""
    drawn = (("the paper's method", paper, style.WITHOUT), ("torchpi", ours, style.TORCHPI))
    return Linked(
        t,
        (
            Panel(
                "displacement", "µm", (*(Curve(*one) for one in drawn), Curve("desired", yd, style.WANTED))
            ),
            Panel("error", "µm", tuple(Curve(name, y - yd, look) for name, y, look in drawn)),
        ),
        view=_first_view(t, yd),
    )


def _first_view(t: Signal, y: Signal) -> tuple[float, float] | None:
    """Return a readable stretch, or None if the whole trace is readable."""
    part = t[readable(y)]
    return (float(part[0]), float(part[-1])) if len(part) < len(t) else None


def recording_traces(recording: Recording) -> Linked:
    """Return the output and input of a recording."""
    return Linked(
        recording.t,
        (
            Panel("output", "µm", (Curve("output", recording.y, style.TORCHPI),)),
            Panel("input", "V", (Curve("input", recording.u, style.WITHOUT),)),
        ),
        view=_first_view(recording.t, recording.y),
    )


def axes_traces(t: Signal, u: Signals, y: Signals) -> Linked:
    """Return the outputs and inputs of a recording of several axes."""
    panels = (
        Panel(name + "s", unit, tuple(Curve(f"{name} {k}", x, look) for k, x, look in _numbered(signals)))
        for name, unit, signals in (("output", "µm", y), ("input", "V", u))
    )
    return Linked(t, tuple(panels), view=_first_view(t, y[:, 0]))


def _numbered(signals: Signals) -> Iterator[tuple[int, Signal, dict[str, Any]]]:
    """Yield each column with its number and line style: (number, column, style)."""
    looks = (style.TORCHPI, style.WITHOUT, *style.OTHERS)
    for k, x in enumerate(signals.T):
        yield k + 1, x, looks[k % len(looks)]


def record_traces(record: RecordFit) -> Linked:
    """Return the displacement, the recorded and predicted voltage, and the residual."""
    recorded = Curve("recorded", record.u, RECORDED_VOLTAGE)
    predicted = Curve("predicted", record.u_hat, PREDICTED)
    residual = Curve("predicted − recorded", 1e3 * (record.u_hat - record.u), VOLTAGE)
    return Linked(
        record.t,
        (
            Panel("displacement", "µm", (Curve("recorded", record.y, style.TORCHPI),), share=0.8),
            Panel("voltage", "V", (recorded, predicted)),
            Panel("residual", "mV", (residual,)),
        ),
        view=_first_view(record.t, record.y),
    )


def diagnosis_traces(trace: "Trace") -> Linked:
    """Return displacement and simulation, residuals before and after, and voltage; held-out parts shaded."""
    unit = unit_of(float(np.abs([trace.residual_retuned, trace.residual_augmented]).max()))
    recorded = Curve("recorded", trace.y, RECORDED)
    simulated = Curve(
        "with what was missing", trace.y - trace.residual_augmented, {**AFTER, "linewidth": 0.9}
    )
    before = Curve("before: retuned", unit.per_um * trace.residual_retuned, BEFORE)
    after = Curve("after: augmented", unit.per_um * trace.residual_augmented, AFTER)
    return Linked(
        trace.t,
        (
            Panel("displacement", "µm", (recorded, simulated)),
            Panel("residual", unit.name, (before, after)),
            Panel("voltage", "V", (Curve("voltage", trace.u, VOLTAGE),), share=0.7),
        ),
        shaded=tuple(
            (float(trace.t[start]), float(trace.t[stop - 1])) for start, stop in stretches(trace.heldout)
        ),
        shade_label="held out",
        title=trace.name,
    )
