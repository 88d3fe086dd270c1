"""Report pages, each a single HTML file with its figures inside and no external resources."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markupsafe import Markup
from matplotlib.figure import Figure

from torchpi.files import write_text
from torchpi.loop.result import COMPENSATED, LoopResult, as_json
from torchpi.report import loop_figures, training_figures, words
from torchpi.report.linked import MOST_NUMBERS, Linked, linked_markup
from torchpi.report.linked_traces import loop_traces, record_traces
from torchpi.report.png import write_png
from torchpi.report.rendering import environment
from torchpi.report.svg import inline_svg
from torchpi.report.training import TrainingReport
from torchpi.report.what_was_run import Provenance


def write_loop_report(
    results: Sequence[LoopResult], provenance: Provenance, directory: str | Path
) -> tuple[Path, Path]:
    """Write `loop.html` and its numbers, `loop.json`, into `directory`; return both paths.

    The page contains its figures; they are also written to `figures/` as PNG, for slides.
    """
    directory = Path(directory)
    page, numbers = directory / "loop.html", directory / "loop.json"
    drawn = [_loop_figures(result) for result in results]
    html, text = _loop_page(results, drawn, provenance), loop_json(results, provenance)
    for result, pictures in zip(results, drawn, strict=True):
        for picture in pictures:
            write_png(picture.figure, directory / "figures" / f"{result.name}_{picture.name}.png")
    write_text(numbers, text)
    write_text(page, html)
    return page, numbers


def write_training_report(report: TrainingReport, provenance: Provenance, path: str | Path) -> Path:
    """Write the training page, usually as `report.html` of the run folder."""
    html = training_page(report, provenance)
    write_text(path, html)
    return Path(path)


def loop_json(results: Sequence[LoopResult], provenance: Provenance) -> str:
    """Return the numbers of the loop page as JSON, with units in the keys."""
    content = {
        "version": 1,
        "trajectories": [as_json(result) for result in results],
        "run": provenance.as_json(),
    }
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _loop_page(
    results: Sequence[LoopResult], drawn: Sequence[Sequence["_Picture"]], provenance: Provenance
) -> str:
    return render(
        "loop.html.j2",
        title="Tracking: " + ", ".join(result.title for result in results),
        provenance=provenance,
        compensated=COMPENSATED,
        runs=[
            {
                "id": f"trajectory-{number}",
                "result": result,
                "answer": words.answer(result),
                "headline": words.headline(result),
                "limits": words.limits(result),
                "figures": _inline(
                    f"t{number}", pictures, {"trajectory": [loop_traces(result)]}, MOST_NUMBERS / len(results)
                ),
            }
            for number, (result, pictures) in enumerate(zip(results, drawn, strict=True), start=1)
        ],
    )


def training_page(report: TrainingReport, provenance: Provenance) -> str:
    """Return the training page as text."""
    return render(
        "training.html.j2",
        title=f"Training: {report.name}",
        report=report,
        metrics=[
            (words.METRICS.get(key, key.replace("_", " ")), key, row) for key, row in report.metrics.items()
        ],
        answer=words.training_answer(report.metrics),
        headline=words.training_headline(report.metrics),
        provenance=provenance,
        figures=_inline(
            "f",
            _training_figures(report),
            {f"traces {record.name}": [record_traces(record)] for record in report.records},
            MOST_NUMBERS / 2,  # half, because its figures are larger
        ),
    )


@dataclass(frozen=True)
class _Picture:
    name: str
    figure: Figure
    caption: str


def _loop_figures(result: LoopResult) -> list[_Picture]:
    captions = {
        "trajectory": "True displacement and reference; below, the error of each drive.",
        "linearity": words.loops(result),
        "error": "Errors with compensation on their own scale, and a zoom on the largest after loading.",
        "voltage": "Voltage written to the stage.",
        "latency": "Time of each step of the compensator, called from Python, including the reading of "
        "the clock.",
    }
    return [_Picture(name, loop_figures.FIGURES[name](result), text) for name, text in captions.items()]


def _training_figures(report: TrainingReport) -> list[_Picture]:
    pictures = []
    for record in report.records:
        of = f"{record.name} ({record.role})"
        pictures += [
            _Picture(
                f"traces {record.name}",
                training_figures.traces_figure(record),
                f"Voltage of {of}, recorded and predicted, and the residual.",
            ),
            _Picture(
                "loop",
                training_figures.loop_figure(record),
                f"Hysteresis of {of}: voltage against displacement.",
            ),
            _Picture(
                "spectrum",
                training_figures.spectrum_figure(record),
                f"Spectrum of the residual of {of}, compared with that of the voltage.",
            ),
        ]
    if report.weights is not None:
        pictures.append(
            _Picture(
                "weights",
                training_figures.weights_figure(report.weights),
                "Weights of the plays against the signed rate, and their running sum over the thresholds: "
                "while it is above 0, the voltage never runs backwards. Neighbouring plays are nearly "
                "collinear: read the sum rather than the single weights.",
            )
        )
    if report.saturation is not None:
        pictures.append(
            _Picture(
                "saturation",
                training_figures.saturation_figure(report.saturation),
                "The polynomial S and its slope: while the slope is above 0, S is monotone.",
            )
        )
    return pictures


def _inline(
    prefix: str,
    pictures: Sequence[_Picture],
    traces: Mapping[str, Sequence[Linked]],
    most: float,
) -> list[dict[str, Any]]:
    """Return the pictures as embedded in the page; a script, if it runs, redraws those of traces."""
    inlined = []
    for number, picture in enumerate(pictures, start=1):
        kind = picture.name.partition(" ")[0]  # keeps names given by users out of identifiers
        svg = Markup(inline_svg(picture.figure, f"{prefix}-{kind}-{number}", picture.caption))
        if picture.name in traces:
            svg = linked_markup(traces[picture.name], svg, most / len(traces))
        inlined.append({"svg": svg, "caption": picture.caption})
    return inlined


def render(template: str, **values: Any) -> str:
    """Return a page from its template and values."""
    return environment(figure=words.figure, times=words.times).get_template(template).render(**values)
