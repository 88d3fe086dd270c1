"""Grade one answer against one sealed label."""

import math
from dataclasses import asdict, dataclass, field

import numpy as np
from concealed.names import GROUPS, STATIC
from numpy.typing import NDArray

UNITS = {  # each with its common unit and factor
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "us": ("s", 1e-6),
    "µs": ("s", 1e-6),
    "Hz": ("Hz", 1.0),
    "kHz": ("Hz", 1e3),
    "mHz": ("Hz", 1e-3),
    "rad/s": ("Hz", 1 / (2 * math.pi)),
    "um": ("um", 1.0),
    "µm": ("um", 1.0),
    "μm": ("um", 1.0),
    "nm": ("um", 1e-3),
    "V/s": ("V/s", 1.0),
    "V/ms": ("V/s", 1e3),
    "um/V": ("um/V", 1.0),
    "µm/V": ("um/V", 1.0),
    "μm/V": ("um/V", 1.0),
    "nm/V": ("um/V", 1e-3),
    "1/um": ("1/um", 1.0),
    "1/µm": ("1/um", 1.0),
    "µm⁻¹": ("1/um", 1.0),
    "1/um^2": ("1/um^2", 1.0),
    "1/µm²": ("1/um^2", 1.0),
    "1/µm^2": ("1/um^2", 1.0),
    "1/V": ("1/V", 1.0),
    "1/V^2": ("1/V^2", 1.0),
    "1/V²": ("1/V^2", 1.0),
    "": ("1", 1.0),
    "1": ("1", 1.0),
    "%": ("1", 1e-2),
    "per decade": ("1", 1.0),
}
LARGEST_GROUP = max(len(group) for group in GROUPS)
HOLD_TICKS = 1.6
"""If readings are taken before the write, a delay of fewer ticks may be the hold of the converter."""
USELESS = 1e9  # error ratio of an unusable prediction: finite, so that results.json is valid JSON
VERDICTS = ("nothing_missing", "explained", "partly_explained", "unexplained")


@dataclass(frozen=True)
class Grade:
    """The grade of one answer. Names are those of the labels; `wrong` has those that nothing excuses."""

    track: str
    case: str
    truth: list[str]
    unknown: list[str]
    family: str
    severities: dict[str, float]
    verdict: str
    named: list[str]
    exact: list[str]
    found: list[str]  # truths whose group was named
    wrong: list[str]
    tolerated: list[str]
    failed: str = ""
    """Why there is no answer that can be graded; empty where there is one."""
    forms: dict[str, str] = field(default_factory=dict)
    foreign: list[str] = field(default_factory=list)
    """Truths in a form that the library lacked when it was written."""
    adequate: bool = True
    """Whether the excitation could show every effect: it has loops, and a band of frequencies."""
    foreseeable: bool = True
    """Whether the command determines what an effect outside the list does."""
    beyond_plays: dict[str, float] = field(default_factory=dict)
    null: bool = False
    injected: bool = False
    named_before: bool = False
    """Whether the untouched recording yields the name just as strongly; the case is then in no count."""
    over_residual: float | None = None
    """Injected rms over the residual that the answer to the untouched recording leaves."""
    heldout_gain: float | None = None
    """Gain of the augmented stage over the retuned nominal, by the tool's own account."""
    heldout_over_noise: float | None = None
    diagnose_s: float | None = None
    parameters: list[dict[str, object]] = field(default_factory=list)
    stated: list[dict[str, object]] = field(default_factory=list)
    """Each name with its probability, whether it is right by itself and right by its alternatives (None where
    it is tolerated)."""

    def as_dict(self) -> dict[str, object]:
        """Return the grade as a dictionary for results.json."""
        return asdict(self)


def unreadable(diagnosis: object) -> str:
    """Return why an answer cannot be graded, or ''. One that breaks the contract counts as no answer."""
    if not isinstance(diagnosis, dict):
        return f"diagnosis.json: found {type(diagnosis).__name__}, expected an object"
    if diagnosis.get("verdict") not in VERDICTS:
        return f"verdict: found {diagnosis.get('verdict')!r}, expected one of {', '.join(VERDICTS)}"
    if not isinstance(diagnosis.get("fit", {}), dict):
        return f"fit: found {type(diagnosis['fit']).__name__}, expected an object"
    effects = diagnosis.get("effects", [])
    if not isinstance(effects, list):
        return f"effects: found {type(effects).__name__}, expected a list"
    for effect in effects:
        if not isinstance(effect, dict) or not isinstance(effect.get("name"), str):
            return f"effects: found {effect!r}, expected an object with a name"
        probability = effect.get("probability")
        if probability is not None and not (_is_number(probability) and 0 <= probability <= 1):
            return f"{effect['name']}: found probability {probability!r}, expected 0 to 1"
        if not _is_number(effect.get("share", 0.0)):
            return f"{effect['name']}: found share {effect['share']!r}, expected a number"
        if not isinstance(effect.get("alternatives", []), list):
            return f"{effect['name']}: found alternatives {effect['alternatives']!r}, expected a list"
        parameters = effect.get("parameters", {})
        if not isinstance(parameters, dict) or not all(isinstance(p, dict) for p in parameters.values()):
            return f"{effect['name']}: found parameters {parameters!r}, expected an object of objects"
    return ""


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)


def grade(
    labels: dict,
    diagnosis: dict | None,
    *,
    predicted_um: NDArray[np.float64] | None = None,
    measured_um: NDArray[np.float64] | None = None,
    diagnose_s: float | None = None,
) -> Grade:
    """Grade a diagnosis (None: the tool failed). Each truth takes one name: its own, else one of its group.

    A name is right for a truth of its group, or for one among its own `alternatives` if these are no more
    than the largest group that u and y cannot tell apart. A tolerated name is neither right nor wrong.
    """
    failed = "no answer" if diagnosis is None else unreadable(diagnosis)
    diagnosis = {"verdict": "failed"} if failed else diagnosis
    effects = diagnosis.get("effects", [])
    truths = {effect["name"]: effect for effect in labels["effects"] if effect["listed"]}
    taken: dict[str, dict] = {}
    left = list(effects)
    for test in (lambda t, e: e["name"] == t, same_group, _alternative):
        for truth in truths:
            match = next((e for e in left if truth not in taken and test(truth, e)), None)
            if match is not None:
                taken[truth] = match
                left = [e for e in left if e is not match]
    excused = [e for e in left if _tolerated(e, labels)]
    exact = [truth for truth, effect in taken.items() if effect["name"] == truth]
    return Grade(
        track=labels["track"],
        case=labels["case"],
        truth=list(truths),
        unknown=labels["unknown"],
        family=labels["family"],
        severities={e["name"]: e["severity"] for e in labels["effects"]},
        verdict=diagnosis["verdict"],
        named=[e["name"] for e in effects],
        exact=exact,
        found=list(taken),
        wrong=[e["name"] for e in left if not any(e is other for other in excused)],
        tolerated=[e["name"] for e in excused],
        failed=failed,
        forms={e["name"]: e["form"] for e in labels["effects"] if "form" in e},
        foreign=[e["name"] for e in labels["effects"] if e["listed"] and e.get("foreign")],
        adequate=labels.get("adequate", True),
        foreseeable=all(e.get("foreseeable", True) for e in labels["effects"]),
        beyond_plays={e["name"]: e["severity_beyond_plays"] for e in labels["effects"]},
        null=not labels["effects"],
        heldout_gain=heldout_gain(diagnosis),
        heldout_over_noise=None if failed else _over_noise(labels, predicted_um, measured_um),
        diagnose_s=diagnose_s,
        parameters=[p for name in exact for p in compared_parameters(truths[name], taken[name])],
        stated=[_stated(e, taken, any(e is other for other in excused)) for e in effects],
    )


def _stated(effect: dict, taken: dict[str, dict], excused: bool) -> dict[str, object]:
    truth = next((t for t, e in taken.items() if e is effect), None)
    by_itself = truth is not None and (effect["name"] == truth or same_group(truth, effect))
    return {
        "name": effect["name"],
        "probability": effect.get("probability"),
        "right": None if excused else by_itself,
        "right_group": None if excused else truth is not None,
    }


def same_group(truth: str, effect: dict) -> bool:
    """Whether u and y cannot tell the named effect from the true one."""
    return any(truth in group and effect["name"] in group for group in GROUPS)


def _alternative(truth: str, effect: dict) -> bool:
    alternatives = effect.get("alternatives", [])
    return truth in alternatives and len({*alternatives, effect["name"]}) <= LARGEST_GROUP


def _tolerated(effect: dict, labels: dict) -> bool:
    name = effect["name"]
    if name == "delay" and labels["timing"] == "before_write":
        seconds = [v for v, unit, _ in _values(effect.get("parameters", {})).values() if unit == "s"]
        return bool(seconds) and max(seconds) < HOLD_TICKS / labels["fs_hz"]  # the hold, named as a delay
    if name in STATIC and labels["family"] == "pi" and STATIC.intersection(labels["names"]):
        return True  # a second name for a static effect that is truly there
    return name in labels["tolerated"]


def _values(parameters: dict) -> dict[str, tuple[float, str, tuple[float, float] | None]]:
    out = {}
    for name, p in parameters.items():
        if not _is_number(p.get("value")):
            continue
        unit, factor = UNITS.get(p.get("unit", ""), (p.get("unit", ""), 1.0))
        ends = p.get("interval_90")
        known = isinstance(ends, list) and len(ends) == 2 and all(_is_number(end) for end in ends)
        out[name] = (p["value"] * factor, unit, (ends[0] * factor, ends[1] * factor) if known else None)
    return out


def compared_parameters(truth: dict, answer: dict) -> list[dict[str, object]]:
    """Compare each true parameter with the answer's of the same name, else with the only one of its unit."""
    true, said = _values(truth["parameters"]), _values(answer.get("parameters", {}))
    rows = []
    for name, (value, unit, _) in true.items():
        same_unit = [n for n in said if said[n][1] == unit]
        alone = sum(u == unit for _, u, _ in true.values()) == 1 and len(same_unit) == 1 and unit != "1"
        match = name if name in said and said[name][1] == unit else same_unit[0] if alone else None
        row: dict[str, object] = {"effect": truth["name"], "severity": truth["severity"], "parameter": name}
        if match is not None and value != 0:
            guess, _, interval = said[match]
            accepted = [
                value,
                *([truth["parameters"][name]["or"]] if "or" in truth["parameters"][name] else []),
            ]
            nearest = min(accepted, key=lambda v: abs(guess - v))
            row["relative_error"] = abs(guess - nearest) / abs(nearest)
            row["covered"] = (
                None if interval is None else any(interval[0] <= v <= interval[1] for v in accepted)
            )
        rows.append(row)
    return rows


def heldout_gain(diagnosis: dict) -> float | None:
    """The share of the retuned held-out error that the augmented stage removes, by the tool's account."""
    retuned, augmented = (heldout_rms_um(diagnosis, fit) for fit in ("retuned", "augmented"))
    return None if not retuned or augmented is None else 1 - augmented / retuned


def heldout_rms_um(diagnosis: dict, fit: str) -> float | None:
    """The held-out rms residual of a fit, by the tool's account; None if it gives none."""
    found = diagnosis.get("fit", {}).get(fit)
    rms = found.get("heldout_rms_um") if isinstance(found, dict) else None
    return rms if _is_number(rms) else None


def _over_noise(labels, predicted_um, measured_um):
    if predicted_um is None or measured_um is None:
        return None
    if predicted_um.shape != measured_um.shape or not np.all(np.isfinite(predicted_um)):
        return USELESS
    lsb = next(
        (e["parameters"]["lsb_um"]["value"] for e in labels["effects"] if e["name"] == "quantization"), 0.0
    )
    floor = math.hypot(labels["noise_rms_um"], lsb / math.sqrt(12))
    return float(np.sqrt(np.mean((predicted_um - measured_um) ** 2)) / floor)
