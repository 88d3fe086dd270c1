"""The paragraph that a colleague understands."""

from collections.abc import Sequence

from torchpi.diagnosis.decide import Decision
from torchpi.diagnosis.diagnosis import Errors, NamedEffect, NextRecording


def paragraph(
    decision: Decision, errors: Sequence[Errors], floor_um: float, measured: bool, next_one: NextRecording
) -> str:
    """What was found, how sure it is, what it buys, what remains, and what to record next.

    `measured` is whether the floor is that of rests or repeats, and not the smallest error reached.
    """
    nominal, retuned, augmented = errors
    noise = f"about {nm(floor_um)}" if measured else f"{nm(floor_um)} at most (no rest or repeat measures it)"
    parts = [
        f"The simulation misses the held-out samples by {nm(nominal.heldout_rms_um)} rms, "
        f"{nm(retuned.heldout_rms_um)} when it is retuned; the noise is {noise}."
    ]
    if decision.verdict == "nothing_missing":
        parts.append("Nothing is missing: what is left is noise, as far as these recordings show.")
    for effect in decision.effects:
        parts.append(sentence(effect))
    if decision.effects:
        parts.append(f"With that the error falls to {nm(augmented.heldout_rms_um)}.")
    if decision.verdict == "partly_explained":
        parts.append(
            f"{percent(decision.unexplained_share)} of the squared mismatch has no name: "
            "none of the known effects explains it."
        )
    if decision.verdict == "unexplained":
        parts.append(
            "Something is missing that none of the known effects explains well enough to be named"
            + (
                f"; a nameless remainder brings the error to {nm(augmented.heldout_rms_um)}."
                if augmented.heldout_rms_um < 0.97 * retuned.heldout_rms_um
                else "."
            )
        )
    parts.append(f"Next: {next_one.why}")
    return " ".join(parts)


def sentence(effect: NamedEffect) -> str:
    """One effect, its size and its confidence."""
    numbers = ", ".join(
        f"{p.name} {p.value:.4g} {p.unit}".strip() if isinstance(p.value, float) else f"{p.name} {p.value}"
        for p in effect.parameters[:3]
        if p.value != 0.0  # what differs between recordings has no common value
    )
    text = (
        f"Missing is {spoken(effect.name)} in the {effect.block} ({numbers}), "
        f"{percent(effect.share)} of the mismatch, probability {percent(effect.probability)}"
    )
    if effect.alternatives:
        others = " or ".join(spoken(name) for name in effect.alternatives)
        text += f"; these recordings cannot tell it from {others}"
    return text + "."


def spoken(name: str) -> str:
    return name.replace("_", " ")


def nm(length_um: float) -> str:
    """A length in the unit in which it is read."""
    return f"{length_um:.3g} µm" if length_um >= 1 else f"{1e3 * length_um:.3g} nm"


def percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share > 0.01 else f"{100 * share:.2g} %"
