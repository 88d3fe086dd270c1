"""Fit the filters of a corrected inverse by least squares on the model's responses to recorded voltages."""

from collections.abc import Sequence

import torch
from torch import Tensor

from torchpi.control.corrected import CorrectedInverse, delayed
from torchpi.control.direct_inverse import DirectInverse
from torchpi.operators.motion import Motion, backward_motion

# Share of the columns' mean square: future errors are smooth, so their taps are nearly collinear.
RIDGE = 1e-9
SKIPPED = 300  # samples at the start of each record


def fit_corrections(
    start: DirectInverse,
    model: DirectInverse,
    voltages: Sequence[Tensor],  # recorded, each (1, time), V
    passes: int = 2,
    before: int = 4,
    ahead: int = 8,
    min_voltage_v: float = 0.0,
    max_voltage_v: float = 10.0,
) -> CorrectedInverse:
    """Fit a corrected inverse whose filters turn the model's responses back into the voltages behind them.

    The responses are free of the sensor's noise. Each pass has its own filter, fitted to the error left by
    the passes before it: one filter for all passes diverges on motions that it was not fitted to.

    Args:
        start: The direct inverse, fitted.
        model: The forward model, fitted.
        voltages: Recorded excitations.
        passes: Number of corrections.
        before: Number of past errors that a filter sees.
        ahead: Number of future errors that it sees; each pass adds as many samples of look-ahead.
        min_voltage_v: Lower output limit.
        max_voltage_v: Upper output limit.
    """
    compensator = CorrectedInverse(
        start, model, torch.zeros(passes, before + 1 + ahead), ahead, min_voltage_v, max_voltage_v
    )
    period = start.sample_period_s
    with torch.no_grad():
        motions = [backward_motion(model.voltage(backward_motion(u, period))[0], period) for u in voltages]
        for p in range(passes):
            late = start.preview + (p + 1) * ahead
            problems = [
                _problem(compensator, motion, delayed(u, late), p)
                for motion, u in zip(motions, voltages, strict=True)
            ]
            errors, left = (torch.cat(parts) for parts in zip(*problems, strict=True))
            compensator.filters[p] = _ridge(errors, left)
    return compensator


def _problem(compensator: CorrectedInverse, motion: Motion, target: Tensor, p: int) -> tuple[Tensor, Tensor]:
    """Return errors that the filter of pass p sees, (samples, taps), and the voltage that it should add."""
    v, e = compensator.passes(motion, p)
    taps = compensator.filters.shape[1]
    errors = torch.stack([delayed(e, i)[0, SKIPPED:] for i in range(taps)], 1)
    return errors, (target - delayed(v, compensator.ahead))[0, SKIPPED:]


def _ridge(columns: Tensor, target: Tensor) -> Tensor:
    size = columns.square().mean(0).sqrt()
    scaled = columns / size
    gram = scaled.T @ scaled / len(scaled)
    gram.diagonal().add_(RIDGE)
    solution: Tensor = torch.linalg.solve(gram, scaled.T @ target / len(scaled)) / size
    return solution
