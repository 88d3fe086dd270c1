"""The paper's identification in two stages, Qin et al. (2013), Section III, eq. 10 and 11.

Stage 1 fits the saturation polynomial c with constant weights to a slow record. The weights enter
linearly, so they are solved for within each trial of c (variable projection, Golub and Pereyra 1973)
and only the m coefficients are searched. Stage 2 keeps c and fits slopes k and offsets b of the
weights to faster records: linear least squares.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.optimize
import torch

from torchpi.compensator import DirectInverse
from torchpi.identification.pair import InversePair
from torchpi.identification.projection import linear_columns


@dataclass(frozen=True)
class TwoStageResult:
    """How the two stages went; the compensator holds what they found.

    Attributes:
        slow: Name of the record of stage 1.
        fast: Names of the records of stage 2.
        slow_rms_v: Error that stage 1 left, V.
        fast_rms_v: Error that stage 2 left, V.
        condition_number: Of the linear problem of stage 2, columns scaled to like size. Neighbouring
            plays are nearly collinear: a large number means that single weights are not determined,
            though the loop is.
    """

    slow: str
    fast: tuple[str, ...]
    slow_rms_v: float
    fast_rms_v: float
    condition_number: float


def fit_two_stage(compensator: DirectInverse, pairs: Sequence[InversePair]) -> TwoStageResult:
    """Fit `compensator` in place: stage 1 on the slowest record, stage 2 on the others.

    A single record serves both. Lead and creep stay as they are. Of a neural rate head, the linear
    part is fitted.
    """
    slow, *fast = sorted(pairs, key=_typical_rate)
    slow_rms_v = fit_saturation(compensator, [slow])
    fast_rms_v, condition_number = fit_weights(compensator, fast or [slow])
    return TwoStageResult(
        slow.name, tuple(pair.name for pair in fast) or (slow.name,), slow_rms_v, fast_rms_v, condition_number
    )


def fit_saturation(compensator: DirectInverse, pairs: Sequence[InversePair]) -> float:
    """Stage 1 (eq. 10) in place: c, with weights that do not follow the rate; returns the rms error, V."""
    wanted = _wanted(pairs)

    def residual(scaled: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            compensator.saturation.scaled.copy_(torch.from_numpy(scaled))
        _, left, _ = _solve(_columns(compensator, pairs, functions=1), wanted)
        return left

    start = compensator.saturation.scaled.detach().numpy().copy()
    steps = [1e-5] * len(start)
    found = scipy.optimize.least_squares(residual, start, diff_step=steps, max_nfev=100)
    left = residual(found.x)
    return float(np.sqrt(np.mean(left**2)))


def fit_weights(compensator: DirectInverse, pairs: Sequence[InversePair]) -> tuple[float, float]:
    """Stage 2 (eq. 11) in place: k and b, c kept; returns the rms error, V, and the condition number."""
    functions = min(compensator.weights.theta.shape[1], 2)
    columns = _columns(compensator, pairs, functions)
    solution, left, condition_number = _solve(columns, _wanted(pairs))
    plays = len(compensator.weights.theta)
    with torch.no_grad():
        compensator.weights.theta.zero_()
        compensator.psi.zero_()
        theta = torch.from_numpy(solution[: plays * functions]).reshape(plays, functions)
        compensator.weights.theta[:, :functions] = theta
        if compensator.offset.requires_grad:
            compensator.offset.fill_(solution[-1])
    return float(np.sqrt(np.mean(left**2))), condition_number


def _columns(compensator: DirectInverse, pairs: Sequence[InversePair], functions: int) -> np.ndarray:
    """Everything that the paper's weights multiply. Shape: (samples, columns)."""
    blocks = []
    with torch.no_grad():
        for pair in pairs:
            h, _ = compensator.play_states(pair.motion)
            basis = compensator.weights.basis(pair.motion.yd_dot)[..., :functions]
            blocks.append(linear_columns(compensator, h[0], basis[0], own_degree=0)[pair.counted])
    return torch.cat(blocks).numpy()


def _wanted(pairs: Sequence[InversePair]) -> np.ndarray:
    return torch.cat([pair.u[0, pair.counted] for pair in pairs]).numpy()


def _solve(columns: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Least squares with columns scaled to like size: solution, residual, condition number.

    A play that a record never moves gives a column of zeros, whose weight is then 0.
    """
    size = np.linalg.norm(columns, axis=0)
    size[size == 0] = 1.0
    solution, _, _, singular = np.linalg.lstsq(columns / size, wanted, rcond=1e-10)
    solution = solution / size
    nonzero = singular[singular > 1e-10 * singular[0]]
    return solution, columns @ solution - wanted, float(nonzero[0] / nonzero[-1])


def _typical_rate(pair: InversePair) -> float:
    return float(pair.motion.yd_dot[0, pair.counted].square().mean().sqrt())
