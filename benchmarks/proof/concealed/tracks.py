"""The tracks: the case that belongs to a track, a seed and an index."""

from pathlib import Path

import numpy as np
from concealed.alien.case import draw_case as draw_alien
from concealed.cases import Case
from concealed.plant.case import TRACKS as PUBLISHED
from concealed.plant.case import Settings
from concealed.plant.case import draw_case as draw_published
from concealed.real.case import draw_case as draw_injected
from concealed.real.sources import draw_residual

DATA = Path(__file__).parents[4] / "shared" / "data"
PROOF = ("alien", "noise", "open", "crime")
DEVELOPMENT = tuple(track for track in PUBLISHED if track not in PROOF)


APART, TRIES = 1_000_000, 5
"""Distance from the index of a diverging plant to that of its replacement; number of attempts."""


def draw(track: str, seed: int, index: int, data: Path = DATA) -> Case:
    """Draw a case; the same arguments give the same case. A plant that diverges is replaced by another.

    Raises:
        OverflowError: The plants of all attempts diverge.
    """
    for attempt in range(TRIES):
        case = _draw(track, seed, index + attempt * APART, data)
        heldout = [] if case.heldout is None else [case.heldout]
        if all(np.isfinite(run["output_um"]).all() for run in [*case.recordings, *heldout]):
            return case
    raise OverflowError(f"{track} {seed}/{index}: {TRIES} plants that diverge")


def _draw(track: str, seed: int, index: int, data: Path) -> Case:
    if track in PUBLISHED:
        return draw_published(Settings(track, seed, index))
    if track != "noise":
        return draw_alien(track, seed, index)
    if index % 2 == 0:
        return draw_injected(data, seed, index // 2)
    return draw_alien(track, seed, index, draw_residual(data, np.random.default_rng([seed, index, 7])))
