"""What the linked traces of each page show."""

import numpy as np

from torchpi.diagnosis.diagnosis import Trace
from torchpi.loop.result import COMPENSATED, WITHOUT, WITHOUT_LOOK_AHEAD, LoopResult
from torchpi.report import style
from torchpi.report.diagnosis_style import AFTER, BEFORE, RECORDED, unit_of
from torchpi.report.linked import Curve, Linked, Panel
from torchpi.report.loop_figures import line_of
from torchpi.report.traces import stretches
from torchpi.report.training import RecordFit
from torchpi.report.training_figures import PREDICTED
from torchpi.report.training_figures import RECORDED as RECORDED_VOLTAGE

VOLTAGE = {**style.TORCHPI, "linewidth": 0.9}


def loop_traces(result: LoopResult) -> Linked:
    """Reference and motion, tracking error, voltage. Errors without compensation hide the others: they
    wait for a click."""
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
            shown=key not in (WITHOUT, WITHOUT_LOOK_AHEAD),
        )
        for key, drive in result.drives.items()
    ]
    voltages = [Curve(result.drives[key].label, result.drives[key].u, line_of(result, key)) for key in both]
    loading_s = float(result.t[result.loading_samples]) if result.loading_samples else 0.0
    return Linked(
        result.t,
        (
            Panel("displacement", "µm", (*motions, reference)),
            Panel("error", "nm", tuple(errors)),
            Panel("voltage", "V", tuple(voltages), share=0.8),
        ),
        shaded=((0.0, loading_s),) if loading_s else (),
        shade_label="loading",
    )


def record_traces(record: RecordFit) -> Linked:
    """Displacement, voltage and what the prediction leaves of it."""
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
    )


def diagnosis_traces(trace: Trace) -> Linked:
    """Displacement and its simulation, residual before and after, voltage; what was held out is shaded."""
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
