"""Write the paragraph that summarises a diagnosis in plain words."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from torchpi.diagnosis.decide import CLOSED, NAMED, Decision
from torchpi.diagnosis.diagnosis import AcrossRecordings, Errors, NamedEffect, NextRecording, Parameter
from torchpi.diagnosis.noise import Noise

CERTAIN = 0.9
"""Probability from which an effect is said to be missing without qualification."""
REMAINDER_HELPS = 0.97
"""The unknown remainder is mentioned if it lowers the error below this fraction of the error without it."""
WORTH_A_SENTENCE = 0.01
"""Share of the squared residual from which a joint explanation is mentioned."""
FAMILIES = {
    "prandtl_ishlinskii": "Prandtl–Ishlinskii",
    "preisach": "Preisach",
    "bouc_wen": "Bouc–Wen",
    "duhem": "Duhem",
}
"""Names of the hysteresis families, after their authors."""
ARTICLES = {
    "hysteresis_operator": "another",
    **dict.fromkeys(("amplifier_lag", "input_nonlinearity"), "an"),
    **dict.fromkeys(("delay", "load_change", "resonance", "second_mode"), "a"),
    **dict.fromkeys(("sensor_lag", "sensor_nonlinearity", "slew_limit"), "a"),
}
"""Articles of the effects whose names are countable: a resonance, but creep."""
WALK = "random walk"
"""Form of an effect that nothing predicts."""
WRONG, MENTIONED = 1.5, 3
"""Ratio of the errors before and after retuning from which it is said what retuning changed, and how many
numbers are mentioned."""
UNIT_SUFFIX = re.compile(r"_(hz|v|um|s|v_s|(?:(?:v|um|s)_)?per_(?:v2|v|um2|um|s|mm))$")


@dataclass(frozen=True)
class Changed:
    """A parameter of the given simulation that retuning changed."""

    effect: str
    name: str
    unit: str
    before: float
    after: float

    @property
    def phrase(self) -> str:
        """What changed, for use in a sentence."""
        before, after = (
            valued(Parameter(self.name, one, self.unit, None)) for one in (self.before, self.after)
        )
        return f"the {spoken_parameter(self.name)} of its {spoken(self.effect)} from {before} to {after}"


def paragraph(
    decision: Decision,
    errors: Sequence[Errors],
    noise: Noise | None,
    next_one: NextRecording,
    leftovers: Sequence[str] = (),
    untested: Sequence[str] = (),
    across: Sequence[AcrossRecordings] = (),
    another_um: float | None = None,
    changed: Sequence[Changed] = (),
) -> str:
    """State what was found, how probable it is, how far it lowers the error, what remains and what to record.

    Args:
        decision: The named effects, and what they leave unexplained.
        errors: Errors of the simulation as given, retuned and augmented.
        noise: The measured noise; None where nothing measures it.
        next_one: The next recording to make.
        leftovers: Where the residual of the augmented simulation stands out, one phrase each.
        untested: The respects in which the held-out samples are alike, one phrase each.
        across: The prediction of each recording from the others.
        another_um: The standard deviation of the prediction of another motion by the hysteresis.
        changed: The parameters of the simulation that retuning changed, the most changed first.
    """
    nominal, retuned, augmented = errors
    parts = [
        f"On the held-out samples the simulation has an error of {nm(nominal.heldout_rms_um)} rms, "
        f"{nm(retuned.heldout_rms_um)} once it is retuned; {noise_clause(noise)}."
    ]
    if changed and nominal.heldout_rms_um > WRONG * retuned.heldout_rms_um:
        parts.append(f"Retuning changes {listed([one.phrase for one in changed[:MENTIONED]])}.")
    if decision.verdict == "nothing_missing":
        parts.append("Nothing is missing: what is left is noise, as far as these recordings show.")
    parts += [sentence(effect) for effect in decision.effects]
    if decision.joint_share >= WORTH_A_SENTENCE:
        parts.append(
            f"{percent(decision.joint_share)} is explained by {together(decision)} together and cannot be "
            "attributed to any single one."
        )
    if decision.effects:
        left = nm(augmented.heldout_rms_um)
        falls = augmented.heldout_rms_um < retuned.heldout_rms_um
        walks = any(effect.form == WALK for effect in decision.effects)
        parts.append(
            f"With this included, the error falls to {left}."
            if falls
            else f"On the held-out samples this brings no improvement: the error is {left} with it"
            f"{', as no stage can predict a random walk' if walks else ''}."
        )
    if untested and (decision.verdict in CLOSED or not decision.carries_over):
        parts.append(
            f"This was tested only on {listed(untested)}: predictions for other motions are extrapolations."
        )
    parts += carried_over(across)
    if another_um is not None:
        parts.append(
            "For motions unlike these, with reversals anywhere in the recorded range, these recordings leave "
            f"the prediction of the hysteresis uncertain by {nm(another_um)} rms."
        )
    for one in decision.causes_left_open:
        text = f"with a probability of {percent(one.probability)} it is too uncertain to be named"
        parts.append(f"There may also be {counted(one.name)}: {text}.")
    if decision.verdict == "partly_explained" and decision.carries_over:
        # Without a measured noise, it is unknown how much of the remaining residual is noise.
        much = "Part" if noise is None else percent(decision.unexplained_share)
        parts.append(
            f"{much} of the squared residual remains unexplained: none of the known effects accounts for it."
        )
    if decision.verdict == "unexplained":
        text = "Something is missing, but none of the known effects explains it well enough to be named"
        if augmented.heldout_rms_um < REMAINDER_HELPS * retuned.heldout_rms_um:
            text += f"; an unnamed remainder lowers the error to {nm(augmented.heldout_rms_um)}"
        parts.append(text + ".")
    if leftovers:
        parts.append(f"The remaining residual stands out in {'; '.join(leftovers)}.")
    parts.append(f"Next: {next_one.why}")
    return " ".join(parts)


def together(decision: Decision) -> str:
    """Name the effects that explain something jointly: the named ones, and those that are left open."""
    names = [effect.name for effect in decision.effects] + [cause.name for cause in decision.causes_left_open]
    return listed([spoken(name) for name in names]) if len(names) > 1 else "several effects"


def carried_over(across: Sequence[AcrossRecordings]) -> list[str]:
    """Say how well the model carries over to other recordings; empty where that was not tested."""
    if not across:
        return []
    worst = max(across, key=lambda one: one.times)
    if worst.predicted:
        how = (
            f"with an error at most {worst.times:.2g} times as large"
            if worst.times > 1.05
            else "equally well"
        )
        return [f"Fitted only to the other recordings, the hysteresis predicts each recording {how}."]
    return [
        "These recordings do not determine the hysteresis for other motions: fitted only to the other "
        f"recordings, it predicts {worst.recording} with an error of {nm(worst.rms_um)}, against "
        f"{nm(worst.fitted_rms_um)} when fitted to all."
    ]


def noise_clause(noise: Noise | None) -> str:
    """State how large the noise is and what measured it."""
    if noise is None:
        return (
            "the noise was not measured: these recordings have no hold, no repeated period and no "
            "repeated recording"
        )
    return f"the noise, measured in {noise.source}, is {nm(noise.rms_um)}"


def sentence(effect: NamedEffect) -> str:
    """Describe one effect with its parameters, its share and its probability."""
    numbers = ", ".join(
        spoken(p.value) if isinstance(p.value, str) else stated(p)
        for p in effect.parameters[:3]
        if p.value != 0.0  # parameters that differ between recordings have no common value
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
    """Return the verb that expresses a probability."""
    return "lacks" if probability >= CERTAIN else "probably lacks" if probability >= NAMED else "may lack"


def listed(phrases: Sequence[str]) -> str:
    """Join several phrases into one: a, b and c."""
    *first, last = phrases
    return f"{', '.join(first)} and {last}" if first else last


def counted(name: str) -> str:
    """Return the name of an effect for use in a sentence, with its article if it takes one."""
    return f"{ARTICLES.get(name, '')} {spoken(name)}".strip()


def spoken(name: str) -> str:
    """Return the name of an effect, or of a hysteresis family, in prose."""
    return FAMILIES.get(name) or name.replace("_", " ")


def spoken_parameter(name: str) -> str:
    """Return a parameter's name in prose without its unit: `frequency_hz[axis 1]` is "frequency [axis 1]"."""
    bare, bracket, label = name.partition("[")
    return spoken(UNIT_SUFFIX.sub("", bare)) + (f" {bracket}{label}" if bracket else "")


def stated(parameter: Parameter) -> str:
    """Return a parameter's name in prose, its value and its unit."""
    return f"{spoken_parameter(parameter.name)} {valued(parameter)}"


def valued(parameter: Parameter) -> str:
    """Return a parameter's value and its unit."""
    shown = readable(parameter)
    value = shown.value if isinstance(shown.value, str) else f"{shown.value:.4g}"
    return f"{value} {shown.unit}".strip()


def readable(parameter: Parameter) -> Parameter:
    """Return a parameter with a time below 0.1 s in ms or µs; any other as it is."""
    value, interval = parameter.value, parameter.interval_90
    if parameter.unit != "s" or isinstance(value, str) or not 0.0 < abs(value) < 0.1:
        return parameter
    factor, unit = (1e3, "ms") if abs(value) >= 1e-3 else (1e6, "µs")
    low_high = interval and (factor * interval[0], factor * interval[1])
    return replace(parameter, value=factor * value, unit=unit, interval_90=low_high)


def nm(length_um: float) -> str:
    """Format a length in µm, or in nm below 1 µm."""
    return f"{length_um:.3g} µm" if length_um >= 1 else f"{1e3 * length_um:.3g} nm"


def percent(share: float) -> str:
    """Format a share or a probability as a percentage, never rounded up to certainty."""
    if 0.995 <= share < 1.0:
        return "over 99 %"
    return f"{100 * share:.0f} %" if share > 0.01 else f"{100 * share:.2g} %"
