"""Items of the reproduction, and the context in which they are computed."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from torchpi.control.corrected import CorrectedInverse
from torchpi.control.direct_inverse import DirectInverse
from torchpi.paper import claims, fig13, recipe, unseen
from torchpi.paper.ablation import PASSES, VARIANTS
from torchpi.paper.calibration import PARTS
from torchpi.paper.fig10 import Identified, identify
from torchpi.paper.tracking import Deployed, InOnePass
from torchpi.stage import Stage


@dataclass(frozen=True)
class Size:
    """Extent of the computation: the whole, or a short form for tests."""

    fig13_hz: tuple[int, ...] = fig13.FREQUENCIES_HZ
    above_hz: tuple[int, ...] = claims.ABOVE_HZ
    unseen: int = unseen.COUNT
    unseen_s: float = 2.0
    evaluations: int = 40
    parts: tuple[str, ...] = PARTS
    ablation: tuple[str, ...] = tuple(VARIANTS)
    ablation_seeds: int = 2
    ablation_passes: tuple[int, ...] = PASSES


FULL = Size()
SHORT = Size((5, 80), (80, 160), 2, 0.3, 15, ("delay",), tuple(VARIANTS)[:1], 1, ())


@dataclass(frozen=True)
class Recipe:
    """Functions by which torchpi learns compensators from recordings alone."""

    fig7: Callable[[], CorrectedInverse | DirectInverse]  # for the plant of Fig. 7
    stage: Callable[[Stage], DirectInverse]  # for the stage


RECIPE = Recipe(recipe.fig7_compensator, recipe.stage_compensator)


@dataclass(frozen=True)
class Context:
    """Inputs available to an item."""

    stage: Stage
    recipe: Recipe
    size: Size
    done: dict[str, Any]  # results of the items that the item needs, by name

    @cached_property
    def identified(self) -> Identified:
        """The paper's compensator, identified on the stage."""
        return identify(self.stage)

    @cached_property
    def compensators(self) -> dict[str, DirectInverse]:
        """The paper's and torchpi's compensator for the stage."""
        return {"paper": self.identified.compensator, "torchpi": self.done["learning"].compensator()}

    def streams(self) -> dict[str, Deployed]:
        """Return both compensators as exported, which run sample by sample."""
        return {name: one.stream() for name, one in self.compensators.items()}

    def in_one_pass(self) -> dict[str, Deployed]:
        """Return both compensators for a whole motion at once, which is faster for many motions."""
        return {name: InOnePass(one) for name, one in self.compensators.items()}


@dataclass(frozen=True)
class Item:
    """One part of the paper.

    Attributes:
        name: Name for `--only`, and the key of its section.
        result: Type of its result, a frozen dataclass with `numbers` and `rows`.
        compute: Computes the result.
        needs: Items whose results it uses.
        of_the_stage: Whether it depends on the stage file.
    """

    name: str
    result: type
    compute: Callable[[Context], Any]
    needs: tuple[str, ...] = ()
    of_the_stage: bool = True
