"""Everything of Qin et al. (2013) that is reproduced, in the paper's order."""

from torchpi.paper import fig4
from torchpi.paper.context import Item
from torchpi.paper.fig10 import fig10
from torchpi.paper.items_ablation import AblationResult, compute_ablation
from torchpi.paper.items_model import (
    Fig3Result,
    Fig4Result,
    Fig5Result,
    Fig7Result,
    Fig8Result,
    compute_fig3,
    compute_fig5,
    compute_fig7,
    compute_fig8,
)
from torchpi.paper.items_stage import (
    CalibrationResult,
    ClaimResult,
    Fig10Result,
    Fig12Result,
    Fig13Result,
    Learning,
    MethodsResult,
    Table1Result,
    UnseenResult,
    compute_calibration,
    compute_fig12,
    compute_fig13,
    compute_learning,
    compute_methods,
    compute_table1,
    compute_unseen,
    trying,
)

ITEMS: dict[str, Item] = {
    item.name: item
    for item in (
        Item("fig3", Fig3Result, compute_fig3, of_the_stage=False),
        Item("fig4", Fig4Result, lambda context: Fig4Result(fig4.fig4()), of_the_stage=False),
        Item("polynomial", ClaimResult, trying("polynomial")),
        Item("fig5", Fig5Result, compute_fig5, of_the_stage=False),
        Item("fig7", Fig7Result, compute_fig7, of_the_stage=False),
        Item("fig8", Fig8Result, compute_fig8, of_the_stage=False),
        Item("calibration", CalibrationResult, compute_calibration),
        Item("jointly", ClaimResult, trying("jointly")),
        Item("two_sets", ClaimResult, trying("two_sets")),
        Item("multisine", ClaimResult, trying("multisine")),
        Item("table1", Table1Result, compute_table1, needs=("fig10",)),
        Item("fig10", Fig10Result, lambda context: Fig10Result(fig10(context.identified))),
        Item("learning", Learning, compute_learning),
        Item("fig12", Fig12Result, compute_fig12, needs=("learning",)),
        Item("methods", MethodsResult, compute_methods, needs=("learning", "fig8", "fig12")),
        Item("ablation", AblationResult, compute_ablation),
        Item("unseen", UnseenResult, compute_unseen, needs=("learning",)),
        Item("fig13", Fig13Result, compute_fig13, needs=("learning",)),
        Item("above_80hz", ClaimResult, trying("above_80hz"), needs=("learning",)),
    )
}
