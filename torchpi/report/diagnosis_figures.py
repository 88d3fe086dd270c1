"""All figures of a diagnosis, by name."""

from matplotlib.figure import Figure

from torchpi.diagnosis.diagnosis import Diagnosis
from torchpi.diagnosis.multisine import all_parts
from torchpi.report.diagnosis_fit import (
    errors_figure,
    heldout_figure,
    loop_figure,
    next_figure,
    remains_figure,
    spectrum_figure,
)
from torchpi.report.diagnosis_what import rivals_figure, signature_figure
from torchpi.report.diagnosis_where import multisine_figure, where_figure

PERIODIC = 2
"""Number of stretches with a periodic input that are drawn, longest first; a table lists them all."""


def diagnosis_figures(diagnosis: Diagnosis) -> dict[str, Figure]:
    """Draw every figure of the diagnosis, by name, as shown on the page and in TensorBoard."""
    figures = {"errors": errors_figure(diagnosis), "where": where_figure(diagnosis.where)}
    longest = sorted(all_parts(diagnosis.traces), key=lambda one: -one.period_s * one.periods)
    for number, parts in enumerate(longest[:PERIODIC], start=1):
        figures[f"multisine_{number}"] = multisine_figure(parts)
    for effect in diagnosis.effects:
        if effect.rivals:  # a converter's lattice is seen directly in the data and has no rivals
            figures[f"rivals_{effect.name}"] = rivals_figure(effect)
        if any(effect.name in trace.signatures for trace in diagnosis.traces):
            figures[f"signature_{effect.name}"] = signature_figure(effect, diagnosis)
    if diagnosis.traces:
        figures["heldout"] = heldout_figure(diagnosis)
        figures["loop"] = loop_figure(diagnosis)
        figures["spectrum"] = spectrum_figure(diagnosis)
    figures["remains"] = remains_figure(diagnosis)
    if len(diagnosis.next_excitation[0]):
        figures["next_excitation"] = next_figure(diagnosis)
    return figures
