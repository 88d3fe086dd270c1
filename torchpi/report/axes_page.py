"""The report page of a diagnosis of several axes."""

from pathlib import Path

from markupsafe import Markup
from matplotlib.figure import Figure

from torchpi.files import write_text
from torchpi.identification.multi_axis.diagnosis import STAGE, AxesDiagnosis
from torchpi.report import style
from torchpi.report.page import render
from torchpi.report.style import canvas
from torchpi.report.svg import inline_svg
from torchpi.report.traces import thinned
from torchpi.report.what_was_run import Provenance

CAPTION = "Slow loops of the actuators of the augmented stage, each at the output that it moves most."


def write_axes_diagnosis(found: AxesDiagnosis, provenance: Provenance, path: Path) -> Path:
    """Write the page and return its path."""
    html = render(
        "axes.html.j2",
        title="Diagnosis of several axes",
        summary=found.summary,
        heldout=found.heldout,
        levels=found.levels,
        names=list(found.levels[0].errors_um),
        best=STAGE,
        svg=Markup(inline_svg(loops_figure(found), "loops", CAPTION)),
        caption=CAPTION,
        provenance=provenance,
    )
    write_text(path, html)
    return path


def loops_figure(found: AxesDiagnosis) -> Figure:
    """Draw displacement over voltage of each actuator, less the line through the ends of its loop."""
    with canvas(2.6 if found.loops else 0.5) as figure:
        for place, loop in enumerate(found.loops, 1):
            axes = figure.add_subplot(1, len(found.loops), place)
            slope = loop.y[loop.u.argmax()] - loop.y[loop.u.argmin()]
            left = loop.y - slope / (loop.u.max() - loop.u.min()) * loop.u
            axes.plot(*thinned(loop.u, left), **style.TORCHPI)
            axes.set(xlabel=f"input {loop.input} (V)", ylabel=f"output {loop.output} minus a line (µm)")
    return figure
