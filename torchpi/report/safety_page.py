"""The safety page of an export, to read before it drives a stage. It formats a card and computes nothing."""

from collections.abc import Mapping
from typing import Any, Protocol

from markupsafe import Markup
from matplotlib.figure import Figure

from torchpi.report import style
from torchpi.report.page import render
from torchpi.report.style import canvas
from torchpi.report.svg import inline_svg
from torchpi.report.what_was_run import Provenance

NOT_KNOWN = "not known"
CAPTION = (
    "Desired displacements: those that the stage can reach, those of the training, beyond which the "
    "compensator extrapolates, and those that are accepted, beyond which its input is held."
)
_RANGES = (
    ("reachable, from the de-energised state", "reachable_um", style.TORCHPI["color"]),
    ("reachable, after a full excursion", "reachable_from_remanence_um", style.OTHERS[3]["color"]),
    ("trained", "trained_range_um", style.OTHERS[1]["color"]),
    ("accepted", "accepted_um", "#999999"),
)


class Card(Protocol):
    """The part of `export.safety_card.SafetyCard` that the page reads."""

    @property
    def monotone(self) -> bool | None: ...
    @property
    def monotone_summary(self) -> str: ...
    def as_json(self) -> dict[str, Any]: ...


# Label, key in the card, unit, and the text shown if there is no value.
_ROWS = (
    ("called every", "sample_period_s", "s", NOT_KNOWN),
    ("look-ahead of the desired displacement", "preview", "samples", NOT_KNOWN),
    ("reachable from the de-energised state, slowly", "reachable_um", "µm", NOT_KNOWN),
    ("lowest displacement after a full excursion (remanence)", "remanence_um", "µm", NOT_KNOWN),
    ("reachable from there, until de-energised again", "reachable_from_remanence_um", "µm", NOT_KNOWN),
    ("output limits", "output_limits_v", "V", NOT_KNOWN),
    ("slew limit", "max_slew_v_s", "V/s", "none (export with --max_slew_v_s)"),
    ("trained range", "trained_range_um", "µm", NOT_KNOWN),
    ("trained rates", "trained_rates_um_s", "µm/s", NOT_KNOWN),
    ("trained accelerations", "trained_accelerations_um_s2", "µm/s²", NOT_KNOWN),
    ("voltages of the trained motions", "trained_voltages_v", "V", NOT_KNOWN),
    ("rates of these voltages", "trained_voltage_rates_v_s", "V/s", NOT_KNOWN),
    ("capacitance of the load", "capacitance_uf", "µF", "not given (export with --capacitance_uf)"),
    ("amplifier gain", "amplifier_gain", "V/V", NOT_KNOWN),
    ("peak current of the trained motions", "current_ma", "mA", NOT_KNOWN),
    ("current at the slew limit", "current_at_slew_limit_ma", "mA", NOT_KNOWN),
    ("accepted inputs; others are held", "accepted_um", "µm", NOT_KNOWN),
    ("largest accepted rate", "accepted_rate_um_s", "µm/s", NOT_KNOWN),
)


def safety_page(name: str, card: Card, provenance: Provenance) -> str:
    """Return the page as text."""
    values = card.as_json()
    return render(
        "safety.html.j2",
        title=f"Safety card: {name}",
        name=name,
        card=card,
        answer=_figure(values["reachable_um"], "µm", NOT_KNOWN),
        picture={"svg": Markup(inline_svg(ranges_figure(values), "ranges", CAPTION)), "caption": CAPTION},
        rows=[(label, key, _figure(values[key], unit, missing)) for label, key, unit, missing in _ROWS],
        provenance=provenance,
    )


def ranges_figure(values: Mapping[str, Any]) -> Figure:
    """Draw the ranges of the desired displacement, one bar for each known range."""
    known = [(label, values[key], color) for label, key, color in _RANGES if values[key] is not None]
    with canvas(0.6 + 0.35 * len(known)) as figure:
        axes = figure.subplots()
        for place, (_, (low, high), color) in enumerate(known):
            axes.barh(-place, high - low, left=low, height=0.55, color=color)
        axes.set_yticks([-place for place in range(len(known))], [label for label, _, _ in known])
        axes.set_xlabel("desired displacement (µm)")
        axes.grid(visible=False, axis="y")
    return figure


def _figure(value: list[float] | float | None, unit: str, missing: str) -> str:
    if value is None:
        return missing
    if isinstance(value, list):
        return f"{value[0]:.4g} … {value[1]:.4g} {unit}"
    return f"{value:.4g} {unit}"
