"""All reproduced items of Qin et al. (2013), in the order of the paper."""

from torchpi.paper import fig4, items_model, items_stage
from torchpi.paper.context import Item
from torchpi.paper.fig10 import fig10
from torchpi.paper.items_ablation import AblationResult, compute_ablation

ITEMS: dict[str, Item] = {
    item.name: item
    for item in (
        Item("fig3", items_model.Fig3Result, items_model.compute_fig3, of_the_stage=False),
        Item(
            "fig4",
            items_model.Fig4Result,
            lambda context: items_model.Fig4Result(fig4.fig4()),
            of_the_stage=False,
        ),
        Item("polynomial", items_stage.ClaimResult, items_stage.trying("polynomial")),
        Item("fig5", items_model.Fig5Result, items_model.compute_fig5, of_the_stage=False),
        Item("fig7", items_model.Fig7Result, items_model.compute_fig7, of_the_stage=False),
        Item("fig8", items_model.Fig8Result, items_model.compute_fig8, of_the_stage=False),
        Item("calibration", items_stage.CalibrationResult, items_stage.compute_calibration),
        Item("jointly", items_stage.ClaimResult, items_stage.trying("jointly")),
        Item("two_sets", items_stage.ClaimResult, items_stage.trying("two_sets")),
        Item("multisine", items_stage.ClaimResult, items_stage.trying("multisine")),
        Item("table1", items_stage.Table1Result, items_stage.compute_table1, needs=("fig10",)),
        Item(
            "fig10",
            items_stage.Fig10Result,
            lambda context: items_stage.Fig10Result(fig10(context.identified)),
        ),
        Item("learning", items_stage.Learning, items_stage.compute_learning),
        Item("fig12", items_stage.Fig12Result, items_stage.compute_fig12, needs=("learning",)),
        Item(
            "methods",
            items_stage.MethodsResult,
            items_stage.compute_methods,
            needs=("learning", "fig8", "fig12"),
        ),
        Item("ablation", AblationResult, compute_ablation),
        Item("unseen", items_stage.UnseenResult, items_stage.compute_unseen, needs=("learning",)),
        Item("fig13", items_stage.Fig13Result, items_stage.compute_fig13, needs=("learning",)),
        Item("above_80hz", items_stage.ClaimResult, items_stage.trying("above_80hz"), needs=("learning",)),
    )
}
