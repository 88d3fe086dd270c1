"""Grade an answer on a recording with a known effect against that on the same recording without it."""

from concealed.judging.grade import (
    LARGEST_GROUP,
    Grade,
    compared_parameters,
    heldout_gain,
    heldout_rms_um,
    unreadable,
)
from concealed.names import group_of

STRENGTHENED = 0.5  # share of the injected variance by which a name given before must have grown


def grade_injected(
    labels: dict, answer: dict | None, untouched: dict | None, *, diagnose_s: float | None = None
) -> Grade:
    """Grade a diagnosis of a real recording; None means that the tool failed: an answer without names.

    A name is right if it is accepted, or has an accepted one among its alternatives (no more than a group
    that u and y cannot tell apart), and the untouched answer lacks it or has less of it. A name is wrong if
    it is not right and is neither a name nor an alternative in the untouched answer. A name that replaces
    another of its group, which u and y cannot tell apart, is not new. Without an answer to the untouched
    recording nothing can be graded, and the case counts as failed.
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
        # The parameters of a name given before are sums of both contributions.
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
    """Whether the variance it explains has grown by at least half of the injected variance."""
    injected = (labels["severity"] or 0.0) * labels["noise_rms_um"]
    earlier = next(e for e in untouched["effects"] if e["name"] == effect["name"])
    growth = _explained(effect, answer) - _explained(earlier, untouched)
    return growth >= STRENGTHENED * injected**2


def _explained(effect: dict, answer: dict) -> float:
    """Variance, µm²: the effect's share of the mismatch above the floor; 0 if the answer does not say."""
    floor = answer.get("fit", {}).get("noise_floor_um") or 0.0
    mismatch = (heldout_rms_um(answer, "retuned") or 0.0) ** 2 - floor**2
    return effect.get("share", 0.0) * max(mismatch, 0.0)


def _over_residual(labels: dict, untouched: dict) -> float | None:
    """Injected rms over the held-out residual of the untouched answer, against which it must be detected."""
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
