"""Contribution of each part of torchpi's compensator, as an item of the reproduction."""

from dataclasses import dataclass
from typing import Any

from torchpi.paper.ablation import VARIANTS, Ablation, ablation
from torchpi.paper.context import Context
from torchpi.paper.result import Result


@dataclass(frozen=True)
class AblationResult(Result):
    """The table of the ablation, over seeds of the phases and of the noise."""

    table: Ablation

    def numbers(self) -> dict[str, Any]:
        stage = {
            variant: {
                figure: {"mean": spread.mean, "least": spread.least, "most": spread.most}
                for figure, spread in spreads.items()
            }
            for variant, spreads in self.table.stage.items()
        }
        return {
            "more": {
                "ablation": {
                    "seeds": self.table.seeds,
                    "stage_percent": stage,
                    "fig7_max_percent_by_passes": self.table.fig7,
                }
            }
        }


def compute_ablation(context: Context) -> AblationResult:
    size = context.size
    variants = {name: VARIANTS[name] for name in size.ablation}
    return AblationResult(ablation(context.stage, size.ablation_seeds, variants, size.ablation_passes))
