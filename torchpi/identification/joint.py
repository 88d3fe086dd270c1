"""Everything at once: the weights solved for, the rest searched by backpropagation through time."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from torchpi.compensator import DirectInverse
from torchpi.identification.pair import InversePair
from torchpi.identification.projection import linear_parameters, projected_loss


def fit_joint(compensator: DirectInverse, pairs: Sequence[InversePair], evaluations: int = 150) -> float:
    """Improve `compensator` in place over whole records, from where it stands; returns the rms error, V.

    Variable projection with L-BFGS: a few dozen records' passes where a search over all numbers takes
    thousands. `python -m train fit` does the same with validation, checkpoints and pictures.
    """
    motions, voltages = [pair.motion for pair in pairs], [pair.u for pair in pairs]
    counted = [pair.counted for pair in pairs]
    optimizer = torch.optim.LBFGS(
        searched_parameters(compensator, weights_are_solved=True),
        max_iter=evaluations,
        max_eval=evaluations,
        history_size=20,
        tolerance_grad=1e-10,
        tolerance_change=1e-13,
        line_search_fn="strong_wolfe",
    )
    with torch.no_grad():
        start = projected_loss(compensator, motions, voltages, counted)

    def closure() -> Tensor:
        optimizer.zero_grad()
        loss = projected_loss(compensator, motions, voltages, counted) / start
        loss.backward()
        return loss

    optimizer.step(closure)  # type: ignore[arg-type]
    with torch.no_grad():
        # The last trial of the line search need not be the point that the optimiser chose.
        return float(projected_loss(compensator, motions, voltages, counted).sqrt())


def searched_parameters(compensator: DirectInverse, weights_are_solved: bool) -> list[nn.Parameter]:
    """What an optimiser moves: all that is trainable, without what least squares gives at each trial."""
    solved = {id(part) for part in linear_parameters(compensator)} if weights_are_solved else set()
    return [
        parameter
        for parameter in compensator.parameters()
        if parameter.requires_grad and parameter.numel() > 0 and id(parameter) not in solved
    ]
