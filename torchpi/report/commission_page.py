"""The page of a commissioning, and its sentences. It formats an outcome and computes nothing."""

from typing import Protocol

from markupsafe import Markup

from torchpi.diagnosis.forward_stage import ForwardStage
from torchpi.identification import InverseErrors
from torchpi.loop.result import LoopResult
from torchpi.recordings.recording import Recording
from torchpi.report import loop_figures, words
from torchpi.report.linked import linked_markup
from torchpi.report.linked_traces import loop_traces
from torchpi.report.page import render
from torchpi.report.svg import inline_svg
from torchpi.report.what_was_run import Provenance
from torchpi.report.words import figure
from torchpi.stage import Stage
from torchpi.stage.identified import Identified


class Commissioned(Protocol):
    """The part of `commission.outcome.Outcome` that the page reads."""

    @property
    def heldout(self) -> Recording: ...
    @property
    def errors(self) -> InverseErrors: ...
    @property
    def forward(self) -> ForwardStage: ...
    @property
    def loop(self) -> LoopResult: ...
    @property
    def looped_s(self) -> float: ...
    @property
    def identified(self) -> Identified: ...
    @property
    def without_um(self) -> float: ...
    @property
    def with_um(self) -> float: ...
    @property
    def times_better(self) -> float: ...
    @property
    def trusted(self) -> bool: ...


def headline(outcome: Commissioned) -> str:
    """Return the headline, e.g. '434 nm → 29 nm rms on your stage, held out, 14 times better'."""
    return (
        f"{nm(outcome.without_um)} → {nm(outcome.with_um)} rms on your stage, held out, "
        f"{words.times(outcome.times_better)}"
    )


def nm(value_um: float) -> str:
    """Format a distance in nm, or in µm from 10 µm on."""
    return f"{figure(value_um)} µm" if value_um >= 10 else f"{figure(1e3 * value_um)} nm"


def stage_sentence(stage: Stage) -> str:
    """Return a sentence on the components of the stage and its own error."""
    assert stage.identified is not None
    effects = []
    for one in stage.effects:
        values = ", ".join(f"{v:.4g} {one.kind.quantities[n].unit}".strip() for n, v in one.values.items())
        effects.append(f"{one.kind.name.replace('_', ' ')} ({values})")
    return (
        f"hysteresis, {', '.join(effects) or 'no dynamics'}; its own error, held out, "
        f"{nm(stage.identified.heldout_rms_um)} rms"
    )


def honest(outcome: Commissioned) -> str:
    """Return sentences on what the error means, and what it does not."""
    own = nm(outcome.identified.heldout_rms_um)
    text = (
        f"Simulated: the compensator follows the motion of {outcome.heldout.name}, which was not used for "
        "training, on a stage model identified from the other recordings. That model itself misses the "
        f"measured displacement of {outcome.heldout.name} by {own} rms (free-run simulation, about its "
        "mean)"
    )
    if outcome.trusted:
        return f"{text}, less than the error with compensation. On your rig the two errors add up."
    return f"{text}, more than the error with compensation: expect {own} or more on your rig."


def limits_sentence(outcome: Commissioned) -> str:
    """Return in one line where the voltage or its rate meets a limit."""
    return " ".join(words.limits(outcome.loop))


def page(outcome: Commissioned, provenance: Provenance) -> str:
    """Return the page as text."""
    drawn = (
        (
            loop_figures.trajectory_figure,
            "Reference and simulated motion; below, the tracking error without and with compensation.",
        ),
        (loop_figures.linearity_figure, words.loops(outcome.loop)),
        (
            loop_figures.error_figure,
            "The error with compensation on its own scale, and a zoom on the largest steady error.",
        ),
        (loop_figures.voltage_figure, "Voltage written to the stage, and its limits."),
    )
    pictures = [
        Markup(inline_svg(draw(outcome.loop), f"c{k}", caption)) for k, (draw, caption) in enumerate(drawn)
    ]
    pictures[0] = linked_markup([loop_traces(outcome.loop)], pictures[0])
    stage = outcome.forward.stage
    return render(
        "commission.html.j2",
        title=f"Commissioning: {headline(outcome)}",
        provenance=provenance,
        outcome=outcome,
        headline=headline(outcome),
        honest=honest(outcome),
        limits=words.limits(outcome.loop),
        drives=outcome.loop.drives.values(),
        effects=[(one.kind, one.values) for one in stage.effects],
        plays=len(stage.hysteresis.thresholds_v),
        nm=nm,
        figures=[{"svg": svg, "caption": caption} for svg, (_, caption) in zip(pictures, drawn, strict=True)],
    )
