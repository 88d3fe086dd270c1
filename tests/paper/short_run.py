"""One short run of everything, for all tests that look at what comes out."""

import tempfile
from functools import cache
from pathlib import Path

from torchpi.cli.reproduce import reproduce
from torchpi.control.direct_inverse import DirectInverse
from torchpi.paper.context import SHORT, Recipe
from torchpi.paper.fig7_plant import Fig7Plant
from torchpi.paper.fig10 import identify
from torchpi.stage import Stage

STAGE = Path(__file__).parents[2] / "configs" / "stage" / "qin2013.yaml"


def of_fig7() -> DirectInverse:
    """The paper's own method: quick, and good enough to see that the page is made."""
    return identify(Fig7Plant()).compensator


def of_stage(stage: Stage) -> DirectInverse:
    return identify(stage).compensator


QUICK = Recipe(of_fig7, of_stage)


@cache
def short_run() -> Path:
    """The folder it left; run once in a session."""
    folder = tempfile.TemporaryDirectory(prefix="torchpi-paper-")
    _kept.append(folder)
    reproduce(Path(folder.name), None, STAGE, SHORT, QUICK)
    return Path(folder.name)


_kept: list[tempfile.TemporaryDirectory] = []  # removed when the session ends
