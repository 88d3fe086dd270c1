"""One answer on a recording with a known effect in it, against that on the same recording without it."""

from dataclasses import asdict, dataclass, field

from judging.grade import LARGEST_GROUP, compared_parameters
from plant.effects import group_of

STRENGTHENED = 0.5  # of the injected variance must be in the growth of a name that was there before


@dataclass(frozen=True)
class Grade:
    """What one answer was worth.

    `outcome` of an effect with a name: "right"; "missed"; "named_before", where the untouched recording has
    that name already and it did not grow, which counts neither way. Of one without a name: "recognised" or
    "overlooked".
    """

    case: str
    source: str
    kind: str
    name: str
    severity: float | None
    severity_over_residual: float | None
    outcome: str
    exact: bool
    wrong: list[str]
    named: list[str]
    named_untouched: list[str]
    verdict: str
    verdict_untouched: str
    diagnose_s: float | None
    parameters: list[dict[str, object]] = field(default_factory=list)
    stated: list[dict[str, object]] = field(default_factory=list)

    def as_dict(self) -> dict[str, object]:
        """For results.json."""
        return asdict(self)


def grade(
    labels: dict, answer: dict | None, untouched: dict | None, *, diagnose_s: float | None = None
) -> Grade:
    """Grade a diagnosis; None where the tool failed, which is an answer without names.

    A name is right where it is accepted, or has an accepted one among its alternatives (these being no more
    than a group that u and y cannot split), and the untouched answer does not have it or has less of it. A
    name is wrong where it is not right, and in the untouched answer neither a name nor an alternative. A name
    in the place of another of its group, which u and y cannot split, is not new.
    """
    effects, before = _effects(answer), _effects(untouched)
    accepted = set(labels["accepted"])
    names_before = {e["name"] for e in before}
    known = names_before.union(*(e.get("alternatives", []) for e in before))
    for gone in names_before - {e["name"] for e in effects}:
        known |= group_of(gone)
    candidates = [e for e in effects if _is_right(e, accepted)]
    new = [e for e in candidates if e["name"] not in names_before]
    grown = [e for e in candidates if e["name"] in names_before and _has_grown(e, labels, answer, untouched)]
    taken = next(iter(sorted(new + grown, key=lambda e: e["name"] not in accepted)), None)
    charged = [e for e in effects if not _is_right(e, accepted) and e["name"] not in known]
    return Grade(
        case=labels["case"],
        source=labels["source"],
        kind=labels["kind"],
        name=labels["name"],
        severity=labels["severity"],
        severity_over_residual=_over_residual(labels, untouched),
        outcome=_outcome(accepted, taken, names_before & {e["name"] for e in effects}, charged, answer),
        exact=taken is not None and _exact(taken, labels),
        wrong=[e["name"] for e in charged],
        named=[e["name"] for e in effects],
        named_untouched=[e["name"] for e in before],
        verdict="failed" if answer is None else answer.get("verdict", ""),
        verdict_untouched="failed" if untouched is None else untouched.get("verdict", ""),
        diagnose_s=diagnose_s,
        # A value that was there before is a sum of both.
        parameters=[
            p for e in new if e is taken and _exact(e, labels) for p in compared_parameters(labels, e)
        ],
        stated=[_stated(e, taken, accepted) for e in effects if e is taken or e in charged],
    )


def _effects(answer: dict | None) -> list[dict]:
    return [] if answer is None else answer.get("effects", [])


def _is_right(effect: dict, accepted: set[str]) -> bool:
    alternatives = {*effect.get("alternatives", []), effect["name"]}
    return effect["name"] in accepted or (
        bool(accepted & alternatives) and len(alternatives) <= LARGEST_GROUP
    )


def _exact(effect: dict, labels: dict) -> bool:
    return effect["name"] == labels["name"]


def _has_grown(effect: dict, labels: dict, answer: dict, untouched: dict) -> bool:
    """Whether it explains more than before by half of what was injected, as variances."""
    injected = (labels["severity"] or 0.0) * labels["noise_rms_um"]
    earlier = next(e for e in untouched["effects"] if e["name"] == effect["name"])
    growth = _explained(effect, answer) - _explained(earlier, untouched)
    return growth >= STRENGTHENED * injected**2


def _explained(effect: dict, answer: dict) -> float:
    """Variance, µm²: the effect's share of the mismatch over the floor."""
    floor = answer["fit"].get("noise_floor_um") or 0.0
    mismatch = answer["fit"]["retuned"]["heldout_rms_um"] ** 2 - floor**2
    return float(effect.get("share", 0.0)) * max(mismatch, 0.0)


def _outcome(
    accepted: set[str], taken: dict | None, in_both: set[str], charged: list[dict], answer: dict | None
) -> str:
    if not accepted:
        unexplained = answer is not None and answer.get("verdict") in ("unexplained", "partly_explained")
        return "recognised" if unexplained and not charged else "overlooked"
    if taken is not None:
        return "right"
    return "named_before" if in_both & accepted else "missed"


def _over_residual(labels: dict, untouched: dict | None) -> float | None:
    """The injected rms over what the untouched answer leaves held out: what it has to be seen against."""
    if untouched is None or labels["severity"] is None:
        return None
    return labels["severity"] * labels["noise_rms_um"] / untouched["fit"]["augmented"]["heldout_rms_um"]


def _stated(effect: dict, taken: dict | None, accepted: set[str]) -> dict[str, object]:
    return {
        "name": effect["name"],
        "probability": effect.get("probability"),
        "right": effect is taken and effect["name"] in accepted,
        "right_group": effect is taken,
    }
