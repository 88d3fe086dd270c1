"""The page of a diagnosis: what is missing, with what probability, where it shows, and what remains."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup
from matplotlib.figure import Figure

from torchpi.diagnosis.diagnosis import Diagnosis, Where
from torchpi.diagnosis.locate import SIGNIFICANT
from torchpi.diagnosis.multisine import Parts, all_parts
from torchpi.diagnosis.say import counted, readable, spoken, spoken_parameter
from torchpi.excitation.files import write_excitation
from torchpi.files import write_text
from torchpi.report import words
from torchpi.report.diagnosis_figures import diagnosis_figures
from torchpi.report.diagnosis_fit import HELDOUT_TRACES
from torchpi.report.diagnosis_json import diagnosis_json
from torchpi.report.diagnosis_style import Unit, unit_of
from torchpi.report.diagnosis_words import headline, in_prose, likelihood, spoken_rivals
from torchpi.report.linked import MOST_NUMBERS, linked_markup
from torchpi.report.linked_traces import diagnosis_traces
from torchpi.report.png import write_png
from torchpi.report.rendering import environment
from torchpi.report.svg import inline_svg
from torchpi.report.what_was_run import Provenance

POINTED_AT = 6
"""Largest number of cells that the text names."""
MOST = 0.6
"""Least share for a sentence on one direction: in a recording with rests, both directions stand out."""


def write_diagnosis(
    diagnosis: Diagnosis,
    provenance: Provenance,
    output_dir: str | Path,
    figures: dict[str, Figure] | None = None,
) -> tuple[Path, Path]:
    """Write `report.html`, `diagnosis.json`, `figures/` and `next_excitation.csv`; return the first two.

    The figures are written as SVG and PNG; those of an earlier diagnosis are removed. The page is made before
    anything is replaced, and each file is replaced whole, the page and the numbers last.

    Args:
        diagnosis: The diagnosis to write.
        provenance: What was run.
        output_dir: Folder to write into.
        figures: `diagnosis_figures(diagnosis)`, if they are drawn already.
    """
    directory = Path(output_dir)
    page, numbers, pictures = directory / "report.html", directory / "diagnosis.json", directory / "figures"
    figures = figures or diagnosis_figures(diagnosis)
    drawn = {name: _drawn(name, figure) for name, figure in figures.items()}
    html = _page(diagnosis, provenance, drawn)
    text = diagnosis_json(diagnosis, provenance)
    for name, figure in figures.items():
        write_png(figure, pictures / f"{name}.png")
        write_text(pictures / f"{name}.svg", _alone(drawn[name]["svg"]))
    for earlier in pictures.glob("*"):
        if earlier.suffix in (".png", ".svg") and earlier.stem not in figures:
            earlier.unlink()
    if len(diagnosis.next_excitation[0]):
        write_excitation(directory / "next_excitation.csv", *diagnosis.next_excitation)
    for path, content in ((page, html), (numbers, text)):
        write_text(path, content)
    return page, numbers


def diagnosis_page(diagnosis: Diagnosis, provenance: Provenance) -> str:
    """Return the page as text."""
    figures = diagnosis_figures(diagnosis)
    return _page(diagnosis, provenance, {name: _drawn(name, figure) for name, figure in figures.items()})


def _page(diagnosis: Diagnosis, provenance: Provenance, drawn: Mapping[str, Mapping[str, str]]) -> str:
    parts = all_parts(diagnosis.traces)
    if "heldout" in drawn:
        shown = [diagnosis_traces(trace) for trace in diagnosis.traces[:HELDOUT_TRACES]]
        live = linked_markup(shown, Markup(drawn["heldout"]["svg"]), MOST_NUMBERS / 2)
        drawn = {**drawn, "heldout": {**drawn["heldout"], "svg": live}}
    unit = unit_of(max(diagnosis.nominal.heldout_rms_um, diagnosis.retuned.heldout_rms_um))
    made = environment(
        figure=_shown,
        spoken=spoken,
        counted=counted,
        spoken_parameter=spoken_parameter,
        readable=readable,
        spoken_rivals=spoken_rivals,
        in_prose=in_prose,
        likelihood=likelihood,
    )
    return made.get_template("diagnosis.html.j2").render(
        title="Diagnosis: " + ", ".join(trace.name for trace in diagnosis.traces),
        diagnosis=diagnosis,
        provenance=provenance,
        verdict=headline(diagnosis),
        answer=_answer(diagnosis),
        unit=unit,
        fits=_fits(diagnosis, unit),
        loudest=_loudest(diagnosis.where),
        significant=SIGNIFICANT,
        multisines=[_multisine_row(one, unit) for one in parts],
        drawn=drawn,
    )


def _answer(diagnosis: Diagnosis) -> str:
    """Return the held-out errors before and after, in one unit."""
    before, after = diagnosis.retuned.heldout_rms_um, diagnosis.augmented.heldout_rms_um
    unit = unit_of(max(before, after))
    return f"{words.figure(unit.per_um * before)} → {words.figure(unit.per_um * after)} {unit.name}"


def _fits(diagnosis: Diagnosis, unit: Unit) -> list[dict[str, Any]]:
    rows = (
        ("nominal", "nominal, as given", diagnosis.nominal),
        ("retuned", "retuned, with no physics added", diagnosis.retuned),
        ("augmented", "augmented with what was missing", diagnosis.augmented),
    )
    floor = diagnosis.noise_floor_um
    return [
        {
            "key": key,
            "label": label,
            "values": [
                unit.per_um * value
                for value in (errors.train_rms_um, errors.heldout_rms_um, errors.heldout_max_um)
            ],
            "over_floor": errors.heldout_rms_um / floor if floor else math.nan,
        }
        for key, label, errors in rows
    ]


def _loudest(where: tuple[Where, ...]) -> list[str]:
    """Describe the significant cell with the largest share in each domain, the largest share first."""
    best: dict[str, Where] = {}
    for cell in where:
        if cell.domain == "direction" and cell.share < MOST:
            continue
        if cell.significance > SIGNIFICANT and cell.share > best.get(cell.domain, _NOWHERE).share:
            best[cell.domain] = cell
    ordered = sorted(best.values(), key=lambda cell: -cell.share)[:POINTED_AT]
    return [f"{_cell(cell)}: {100 * cell.share:.0f} %" for cell in ordered]


_NOWHERE = Where("time", (0.0, 0.0), "s", 0.0, 0.0)

_DOMAINS = {
    "time": "time",
    "frequency": "frequency",
    "displacement": "displacement",
    "rate": "rate of the input",
    "direction": "direction",
    "since_reversal": "time since the last reversal",
    "amplitude": "swing of the input",
    "recording": "recording",
}


def _cell(cell: Where) -> str:
    domain = _DOMAINS[cell.domain]
    if cell.domain == "recording":
        return f"{domain} {cell.label}"
    if cell.domain == "direction":
        return f"{domain} “{cell.label}”"
    low, high = (words.figure(value, 2) for value in cell.range)
    of = f" ({cell.label})" if cell.label and cell.domain in ("time", "rate") else ""
    return f"{domain} {low} … {high} {cell.unit}{of}"


def _multisine_row(parts: Parts, unit: Unit) -> dict[str, Any]:
    return {
        "name": parts.recording,
        "start_s": parts.start_s,
        "periods": parts.periods,
        "period_s": parts.period_s,
        "noise": unit.per_um * parts.noise_um,
        "parts": [
            {
                "value": None if size is None else unit.per_um * size,
                "significant": parts.significance[part] > SIGNIFICANT,
            }
            for part, size in parts.rms_um.items()
        ],
    }


_CAPTIONS = {
    "errors": "Held-out error of three stages: as given, retuned without adding any physics, and with what "
    "was missing added. Error that retuning removes was due to wrong parameters, not to missing physics.",
    "where": "Where the retuned stage's residual lies: share of the squared residual, minus the noise if it "
    "was measured. Strongly coloured cells (bold numbers in time) exceed the rest by more than "
    f"{SIGNIFICANT:g} standard deviations, which take the residual's own spectrum into account; pale "
    "ones may be due to chance. The height of a bar is the share of its cell, whatever the cell's "
    "width.",
    "heldout": "Recorded motion, and the residual of each stage. Shaded stretches were held out: no stage "
    "was fitted to them. Single readings beyond the scale, such as a start-up, are cut off.",
    "loop": "The recording with the largest residual: its loop, opened by subtracting a straight line, and "
    "the residual against the voltage. A residual that still forms a pattern here is not yet modelled.",
    "spectrum": "Spectrum of the held-out residual. If the noise was measured, it is drawn as white noise "
    "of that rms: where “after” reaches it, nothing is left to explain.",
    "remains": "How the squared mismatch is divided among its causes.",
    "next_excitation": "The voltage of the next recording.",
}


def _drawn(name: str, figure: Figure) -> dict[str, str]:
    if name.startswith("multisine_"):
        caption = (
            "Spectral lines of the residual under the periodic input. Lines that were not excited contain "
            "nonlinear distortion alone: even lines its asymmetric part, odd lines its symmetric part. If "
            "there are many lines, only the largest of each group is drawn."
        )
    elif name.startswith("rivals_"):
        caption = (
            "The named effect (solid), those that these recordings cannot distinguish from it (dotted), "
            "and others that were tried in its place (hatched), each fitted together with everything "
            "else. The effect's probability includes that of the dotted ones."
        )
    elif name.startswith("signature_"):
        caption = (
            "What the effect adds to the displacement, in the stretch where it adds most, compared with "
            "the residual of the retuned stage there."
        )
    else:
        caption = _CAPTIONS[name]
    return {"svg": Markup(inline_svg(figure, name.replace("_", "-"), caption)), "caption": caption}


def _alone(svg: str) -> str:
    """Return an inline figure as a file, which needs its namespace; `Markup` would escape that."""
    return str(svg).replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1) + "\n"


def _shown(value: float | str | None, digits: int = 3) -> str:
    """Format to three digits; very small and very large values with an exponent, a missing one as a dash."""
    if isinstance(value, str):
        return value
    if value is None or math.isnan(value):
        return "–"
    if value and math.isfinite(value) and not 1e-3 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}".replace("-", "−")
    return words.figure(value, digits)
