"""The page of an export: what to know before it drives a stage. It formats a card, and computes nothing."""

from typing import Any, Protocol

from torchpi.report.page import render
from torchpi.report.what_was_run import Provenance

NOT_KNOWN = "not known"


class Card(Protocol):
    """What the page reads of `export.safety_card.SafetyCard`."""

    @property
    def monotone(self) -> bool | None: ...
    @property
    def monotone_summary(self) -> str: ...
    def as_json(self) -> dict[str, Any]: ...


_ROWS = (
    ("reachable from the de-energised state", "reachable_um", "µm"),
    ("lowest displacement after a full excursion (remanence)", "remanence_um", "µm"),
    ("output limits", "output_limits_v", "V"),
    ("slew limit", "max_slew_v_s", "V/s"),
    ("trained range", "trained_range_um", "µm"),
    ("trained rates", "trained_rates_um_s", "µm/s"),
    ("voltages of the trained motions", "trained_voltages_v", "V"),
    ("rates of these voltages", "trained_voltage_rates_v_s", "V/s"),
    ("peak current of the trained motions", "current_ma", "mA"),
    ("current at the slew limit", "current_at_slew_limit_ma", "mA"),
    ("accepted inputs; others are held", "accepted_um", "µm"),
    ("largest accepted rate", "accepted_rate_um_s", "µm/s"),
)


def safety_page(name: str, card: Card, provenance: Provenance) -> str:
    """The page as text."""
    values = card.as_json()
    return render(
        "safety.html.j2",
        title=f"Safety card: {name}",
        name=name,
        card=card,
        rows=[(label, key, _figure(values[key], unit)) for label, key, unit in _ROWS],
        provenance=provenance,
    )


def _figure(value: list[float] | float | None, unit: str) -> str:
    if value is None:
        return NOT_KNOWN if unit != "V/s" else "none"
    if isinstance(value, list):
        return f"{value[0]:.4g} … {value[1]:.4g} {unit}"
    return f"{value:.4g} {unit}"
