"""One short run of `reproduce`, shared by all tests that examine its output."""

from pathlib import Path

from tests.shared import made_once
from torchpi.cli.reproduce import reproduce
from torchpi.control.direct_inverse import DirectInverse
from torchpi.paper.context import SHORT, Recipe
from torchpi.paper.fig7_plant import Fig7Plant
from torchpi.paper.fig10 import identify
from torchpi.stage import Stage

STAGE = Path(__file__).parents[2] / "configs" / "stage" / "qin2013.yaml"


def of_fig7() -> DirectInverse:
    """Fit by the paper's own method: quick, and good enough to test that the page is made."""
    return identify(Fig7Plant()).compensator


def of_stage(stage: Stage) -> DirectInverse:
    return identify(stage).compensator


QUICK = Recipe(of_fig7, of_stage)


def short_run() -> Path:
    """Return the output folder of the run."""
    return made_once("paper", lambda folder: reproduce(folder, None, STAGE, SHORT, QUICK))
