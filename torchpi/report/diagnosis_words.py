"""Wording of the page of a diagnosis: the verdict with its number, and names without underscores."""

import re
from collections.abc import Sequence

from torchpi.diagnosis.decide import NAMED
from torchpi.diagnosis.diagnosis import Diagnosis, Rival
from torchpi.diagnosis.say import CERTAIN, nm, percent, spoken
from torchpi.report import words
from torchpi.stage.effects import EFFECTS

NAMES = re.compile(
    r"\b(" + "|".join(e.name for e in EFFECTS if "_" in e.name) + r"|hysteresis_operator)\b(?=[\s:;,.)]|$)"
)


def headline(diagnosis: Diagnosis) -> str:
    """Return the verdict in one line, with the number from which it follows."""
    error = nm(diagnosis.augmented.heldout_rms_um)
    if diagnosis.noise_floor_um is None:
        against = "noise not measured"
    elif diagnosis.noise_floor_um > 0:
        times = words.figure(diagnosis.augmented.heldout_rms_um / diagnosis.noise_floor_um)
        against = f"{times} times the noise"
    else:
        against = "no noise"
    if diagnosis.verdict == "partly_explained" and not diagnosis.carries_over:
        return f"Explained for these motions only: held-out error {error}, {against}"
    return {
        "nothing_missing": f"Nothing is missing: held-out error {error}, {against}",
        "explained": f"Explained: held-out error {error}, {against}",
        "partly_explained": f"Partly explained: {unexplained(diagnosis)}held-out error {error}, {against}",
        "unexplained": "Something is missing that no known effect explains: "
        f"held-out error {error}, {against}",
    }[diagnosis.verdict]


def unexplained(diagnosis: Diagnosis) -> str:
    """Say how much is unexplained; empty if the noise in the remaining error is unknown."""
    if diagnosis.noise_floor_um is None:
        return ""
    return f"{percent(diagnosis.unexplained_share)} of the squared mismatch is not; "


def likelihood(probability: float) -> str:
    """Return a probability in words."""
    if probability >= CERTAIN:
        return "missing"
    return "probably missing" if probability >= NAMED else "may be missing"


def spoken_rivals(rivals: Sequence[Rival]) -> list[str]:
    """Return the rivals' names in prose, with the form if a name occurs twice."""
    names = [rival.name for rival in rivals]
    return [
        spoken(rival.name) + (f" ({rival.form})" if rival.form and names.count(rival.name) > 1 else "")
        for rival in rivals
    ]


def in_prose(text: str) -> str:
    """Return a sentence with effects called by their spoken names."""
    return NAMES.sub(lambda found: spoken(found[0]), text)
