"""The paragraph that a colleague understands."""

import re
from collections.abc import Sequence

from torchpi.diagnosis.decide import CLOSED, NAMED, Decision
from torchpi.diagnosis.diagnosis import AcrossRecordings, Errors, NamedEffect, NextRecording
from torchpi.diagnosis.noise import Noise

CERTAIN = 0.9
"""Probability from which an effect is missing without qualification."""
REMAINDER_HELPS = 0.97
"""Of the error without it: below this the unknown remainder is worth a sentence."""
WORTH_A_SENTENCE = 0.01
"""Of the squared residual."""
FAMILIES = {
    "prandtl_ishlinskii": "Prandtl–Ishlinskii",
    "preisach": "Preisach",
    "bouc_wen": "Bouc–Wen",
    "duhem": "Duhem",
}
"""Of hysteresis, by the names of their authors."""
ARTICLES = {
    "hysteresis_operator": "another",
    **dict.fromkeys(("amplifier_lag", "input_nonlinearity"), "an"),
    **dict.fromkeys(("delay", "load_change", "resonance", "second_mode"), "a"),
    **dict.fromkeys(("sensor_lag", "sensor_nonlinearity", "slew_limit"), "a"),
}
"""Of effects that are counted: a resonance, but creep."""
KNOT = "knot"
"""How the numbers of a random walk are called."""
UNIT_SUFFIX = re.compile(r"_(hz|v|um|s|v_s|(?:(?:v|um|s)_)?per_(?:v2|v|um2|um|s|mm))$")


def paragraph(
    decision: Decision,
    errors: Sequence[Errors],
    noise: Noise | None,
    next_one: NextRecording,
    leftovers: Sequence[str] = (),
    untested: Sequence[str] = (),
    across: Sequence[AcrossRecordings] = (),
) -> str:
    """What was found, how probable it is, what it buys, what remains, and what to record next.

    Args:
        decision: The named effects, and what they leave.
        errors: Of the simulation as given, retuned and augmented.
        noise: What was measured of it; None where nothing measures it.
        next_one: The next recording.
        leftovers: Where the residual of the augmented simulation stands out, one phrase each.
        untested: In what the held-out samples are alike, one phrase each.
        across: Each recording, predicted by the others.
    """
    nominal, retuned, augmented = errors
    parts = [
        f"On the held-out samples the simulation has an error of {nm(nominal.heldout_rms_um)} rms, "
        f"{nm(retuned.heldout_rms_um)} once it is retuned; {noise_clause(noise)}."
    ]
    if decision.verdict == "nothing_missing":
        parts.append("Nothing is missing: what is left is noise, as far as these recordings show.")
    parts += [sentence(effect) for effect in decision.effects]
    if decision.joint_share >= WORTH_A_SENTENCE:
        parts.append(
            f"{percent(decision.joint_share)} is explained by several of them together, "
            "and by none beside the others."
        )
    if decision.effects:
        left = nm(augmented.heldout_rms_um)
        falls = augmented.heldout_rms_um < retuned.heldout_rms_um
        parts.append(
            f"With that the error falls to {left}."
            if falls
            else f"On the held-out samples that is no gain: the error is {left} with it."
        )
    if untested and decision.verdict in CLOSED:
        parts.append(
            f"This was tested only on {listed(untested)}: what is predicted of other motions is extrapolated."
        )
    parts += carried_over(across)
    for one in decision.causes_left_open:
        text = f"with a probability of {percent(one.probability)} it is too uncertain to be named"
        parts.append(f"There may also be {counted(one.name)}: {text}.")
    if decision.verdict == "partly_explained" and all(one.predicted for one in across):
        # Without the noise it is not known how much of what is left is noise.
        much = "Part" if noise is None else percent(decision.unexplained_share)
        parts.append(
            f"{much} of the squared residual stays unexplained: none of the known effects accounts for it."
        )
    if decision.verdict == "unexplained":
        text = "Something is missing, but none of the known effects explains it well enough to be named"
        if augmented.heldout_rms_um < REMAINDER_HELPS * retuned.heldout_rms_um:
            text += f"; an unnamed remainder lowers the error to {nm(augmented.heldout_rms_um)}"
        parts.append(text + ".")
    if leftovers:
        parts.append(f"What is left stands out in {'; '.join(leftovers)}.")
    parts.append(f"Next: {next_one.why}")
    return " ".join(parts)


def carried_over(across: Sequence[AcrossRecordings]) -> list[str]:
    """How far a model that explains these recordings holds for others; nothing where that was not asked."""
    if not across:
        return []
    worst = max(across, key=lambda one: one.times)
    if worst.predicted:
        how = f"with an error at most {worst.times:.2g} times as large" if worst.times > 1.05 else "as well"
        return [f"Fitted to the others alone, the hysteresis predicts each recording {how}."]
    return [
        "These recordings do not determine the hysteresis for other motions: fitted to the others alone, it "
        f"predicts {worst.recording} with an error of {nm(worst.rms_um)}, against {nm(worst.fitted_rms_um)} "
        "with all."
    ]


def noise_clause(noise: Noise | None) -> str:
    """How large the noise is and what measured it."""
    if noise is None:
        return "the noise was not measured: these recordings have no hold, no repeated period and no repeat"
    return f"the noise, measured in {noise.source}, is {nm(noise.rms_um)}"


def sentence(effect: NamedEffect) -> str:
    """One effect, its parameters, its share and its probability."""
    numbers = ", ".join(
        spoken(p.value)
        if isinstance(p.value, str)
        else f"{spoken_parameter(p.name)} {p.value:.4g} {p.unit}".strip()
        for p in effect.parameters[:3]
        # What differs between recordings has no common value; of a walk no single number says anything.
        if p.value != 0.0 and not p.name.startswith(KNOT)
    )
    inside = "; ".join(filter(None, (effect.form, numbers)))
    where = "" if effect.block in effect.name else f" in the {effect.block}"
    text = (
        f"The simulation {lacks(effect.probability)} {counted(effect.name)}{where}"
        f"{f' ({inside})' if inside else ''}: {percent(effect.share)} of the squared residual, "
        f"probability {percent(effect.probability)}"
    )
    if effect.alternatives:
        others = " or ".join(map(counted, effect.alternatives))
        text += f"; these recordings cannot distinguish it from {others}"
    return text + "."


def lacks(probability: float) -> str:
    """The verb that goes with a probability."""
    return "lacks" if probability >= CERTAIN else "probably lacks" if probability >= NAMED else "may lack"


def listed(phrases: Sequence[str]) -> str:
    """Several as one: a, b and c."""
    *first, last = phrases
    return f"{', '.join(first)} and {last}" if first else last


def counted(name: str) -> str:
    """The name of an effect in a sentence, with its article if it takes one."""
    return f"{ARTICLES.get(name, '')} {spoken(name)}".strip()


def spoken(name: str) -> str:
    """The name of an effect, or of a family of hysteresis, in prose."""
    return FAMILIES.get(name) or name.replace("_", " ")


def spoken_parameter(name: str) -> str:
    """The name of a parameter in prose, without its unit; of `frequency_hz[axis 1]`, "frequency [axis 1]"."""
    bare, bracket, label = name.partition("[")
    return spoken(UNIT_SUFFIX.sub("", bare)) + (f" {bracket}{label}" if bracket else "")


def nm(length_um: float) -> str:
    """A length in the unit in which it is read."""
    return f"{length_um:.3g} µm" if length_um >= 1 else f"{1e3 * length_um:.3g} nm"


def percent(share: float) -> str:
    """A share or a probability; never rounded up to certainty."""
    if 0.995 <= share < 1.0:
        return "over 99 %"
    return f"{100 * share:.0f} %" if share > 0.01 else f"{100 * share:.2g} %"
