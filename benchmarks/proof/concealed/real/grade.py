"""One answer on a recording with a known effect in it, against that on the same recording without it."""

from concealed.judging.grade import (
    LARGEST_GROUP,
    Grade,
    compared_parameters,
    heldout_gain,
    heldout_rms_um,
    unreadable,
)
from concealed.names import group_of

STRENGTHENED = 0.5  # of the injected variance must be in the growth of a name that was there before


def grade_injected(
    labels: dict, answer: dict | None, untouched: dict | None, *, diagnose_s: float | None = None
) -> Grade:
    """Grade a diagnosis of a real recording; None where the tool failed, which is an answer without names.

    A name is right where it is accepted, or has an accepted one among its alternatives (these being no more
    than a group that u and y cannot split), and the untouched answer does not have it or has less of it. A
    name is wrong where it is not right, and in the untouched answer neither a name nor an alternative. A name
    in place of another of its group, which u and y cannot split, is not new. Without an answer to the
    untouched recording nothing can be graded: the case counts as failed.
    """
    failed = next(
        (why for a in (answer, untouched) if (why := "no answer" if a is None else unreadable(a))), ""
    )
    effects, before = ([], []) if failed else (_effects(answer), _effects(untouched))
    accepted, nameless = set(labels["accepted"]), not labels["accepted"]
    names_before = {e["name"] for e in before}
    known = names_before.union(*(e.get("alternatives", []) for e in before))
    for gone in names_before - {e["name"] for e in effects}:
        known |= group_of(gone)
    candidates = [e for e in effects if _is_right(e, accepted)]
    new = [e for e in candidates if e["name"] not in names_before]
    grown = [e for e in candidates if e["name"] in names_before and _has_grown(e, labels, answer, untouched)]
    taken = min(
        new + grown, key=lambda e: (e["name"] != labels["name"], e["name"] not in accepted), default=None
    )
    charged = [e for e in effects if not _is_right(e, accepted) and e["name"] not in known]
    exact = taken is not None and taken["name"] == labels["name"]
    in_both = names_before & {e["name"] for e in effects} & accepted
    return Grade(
        track=labels["track"],
        case=labels["case"],
        truth=[] if nameless else [labels["name"]],
        unknown=[labels["kind"]] if nameless else [],
        family=labels["source"],
        severities={labels["kind"] if nameless else labels["name"]: labels["severity"] or 0.0},
        verdict="failed" if failed else answer["verdict"],
        named=[e["name"] for e in effects],
        exact=[labels["name"]] if exact else [],
        found=[] if taken is None else [labels["name"]],
        wrong=[e["name"] for e in charged],
        tolerated=[e["name"] for e in effects if e is not taken and not any(e is c for c in charged)],
        failed=failed,
        forms={labels["name"]: labels["form"]},
        injected=True,
        foreseeable=False,
        named_before=taken is None and bool(in_both),
        over_residual=None if failed else _over_residual(labels, untouched),
        heldout_gain=None if failed else heldout_gain(answer),
        diagnose_s=diagnose_s,
        # A value that was there before is a sum of both.
        parameters=[p for e in new if e is taken and exact for p in compared_parameters(labels, e)],
        stated=[_stated(e, taken, accepted) for e in effects if e is taken or any(e is c for c in charged)],
    )


def _effects(answer: dict) -> list[dict]:
    return answer.get("effects", [])


def _is_right(effect: dict, accepted: set[str]) -> bool:
    alternatives = {*effect.get("alternatives", []), effect["name"]}
    return effect["name"] in accepted or (
        bool(accepted & alternatives) and len(alternatives) <= LARGEST_GROUP
    )


def _has_grown(effect: dict, labels: dict, answer: dict, untouched: dict) -> bool:
    """Whether it explains more than before by half of what was injected, as variances."""
    injected = (labels["severity"] or 0.0) * labels["noise_rms_um"]
    earlier = next(e for e in untouched["effects"] if e["name"] == effect["name"])
    growth = _explained(effect, answer) - _explained(earlier, untouched)
    return growth >= STRENGTHENED * injected**2


def _explained(effect: dict, answer: dict) -> float:
    """Variance, µm²: the effect's share of the mismatch over the floor; 0 without an account of it."""
    floor = answer.get("fit", {}).get("noise_floor_um") or 0.0
    mismatch = (heldout_rms_um(answer, "retuned") or 0.0) ** 2 - floor**2
    return effect.get("share", 0.0) * max(mismatch, 0.0)


def _over_residual(labels: dict, untouched: dict) -> float | None:
    """The injected rms over what the untouched answer leaves held out: what it has to be seen against."""
    left = heldout_rms_um(untouched, "augmented")
    if not left or labels["severity"] is None:
        return None
    return labels["severity"] * labels["noise_rms_um"] / left


def _stated(effect: dict, taken: dict | None, accepted: set[str]) -> dict[str, object]:
    return {
        "name": effect["name"],
        "probability": effect.get("probability"),
        "right": effect is taken and effect["name"] in accepted,
        "right_group": effect is taken,
    }
