"""The paper's identification in two stages, Qin et al. (2013), Section III, eq. 10 and 11.

Stage 1 fits the saturation polynomial c with constant weights to a slow record. The weights enter linearly,
so they are solved for within each trial of c (variable projection, Golub and Pereyra 1973) and only the m
coefficients are searched, by damped Gauss–Newton with the exact derivative, from several scales or, as in the
paper, from one start. Stage 2 keeps c and fits slopes k and offsets b of the weights to faster records by
linear least squares.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from torchpi.control.direct_inverse import DirectInverse
from torchpi.identification.inverse_columns import InverseColumns
from torchpi.identification.pair import InversePair
from torchpi.identification.projected_problem import ProjectedProblem
from torchpi.identification.search import descend, search
from torchpi.identification.thin_qr import ThinQR
from torchpi.operators.motion import Motion

EVALUATIONS = 100  # of stage 1, at most
BLOCK = 10_000  # samples of stage 2 at a time
DEPENDENT = 1e-10  # singular values below this share of the largest count as zero


@dataclass(frozen=True)
class TwoStageResult:
    """Errors of the two stages; the compensator holds the parameters that they found.

    Attributes:
        slow: Name of the record of stage 1.
        fast: Names of the records of stage 2.
        slow_rms_v: Rms error of stage 1, V.
        fast_rms_v: Rms error of stage 2, V.
        condition_number: Condition number of the linear problem of stage 2, with columns scaled to equal
            norm. Neighbouring plays are nearly collinear: a large number means that single weights are not
            determined, though the loop is.
    """

    slow: str
    fast: tuple[str, ...]
    slow_rms_v: float
    fast_rms_v: float
    condition_number: float


def fit_two_stage(
    compensator: DirectInverse,
    pairs: Sequence[InversePair],
    several_starts: bool = True,
) -> TwoStageResult:
    """Fit `compensator` in place: stage 1 on the slowest record, stage 2 on the others.

    A single record serves for both. Lead and creep stay as they are. Of a neural rate head, only the linear
    part is fitted.

    Args:
        compensator: Changed in place.
        pairs: Records, made with the compensator's preview.
        several_starts: If False, stage 1 descends only from the current c, as in the paper, to the nearest
            minimum, which need not be the deepest.

    Example:
        >>> from torchpi import DirectInverse, Recording, Stage
        >>> from torchpi.excitation import make_excitation
        >>> from torchpi.identification import fit_two_stage, inverse_errors, inverse_pair
        >>> rig = Stage.from_yaml("default")  # in place of your own stage
        >>> t, u = make_excitation("sine_5hz", rig.sample_rate_hz, 0.4)
        >>> pair = inverse_pair(Recording.from_arrays(t, u, rig.simulate(u[None])[1][0]), preview=2)
        >>> inverse = DirectInverse(1e-4, [0.0, 0.1, 0.3, 0.8, 1.8], degree=3, preview=2, range_um=8.0)
        >>> fitted = fit_two_stage(inverse, [pair])
        >>> inverse_errors(inverse, [pair]).rms_percent < 0.5
        True
    """
    slow, *fast = sorted(pairs, key=lambda pair: pair.rate_um_s)
    slow_rms_v = fit_saturation(compensator, [slow], several_starts)
    fast_rms_v, condition_number = fit_weights(compensator, fast or [slow])
    return TwoStageResult(
        slow.name, tuple(pair.name for pair in fast) or (slow.name,), slow_rms_v, fast_rms_v, condition_number
    )


def fit_saturation(
    compensator: DirectInverse,
    pairs: Sequence[InversePair],
    several_starts: bool = True,
) -> float:
    """Fit c with rate-independent weights in place, as stage 1 (eq. 10); return the rms error, V."""
    problem = ProjectedProblem(compensator, pairs, ["c"], functions=1, own_degree=0)
    alpha, solved = (search if several_starts else descend)(problem, EVALUATIONS)
    problem.put(alpha, solved.beta)
    return float(solved.mean_square**0.5)


def fit_weights(compensator: DirectInverse, pairs: Sequence[InversePair]) -> tuple[float, float]:
    """Fit k and b at fixed c in place, as stage 2 (eq. 11); return the rms error, V, and condition number.

    A play that no record moves gets the weight 0.
    """
    columns = InverseColumns(compensator, min(compensator.weights.theta.shape[1], 2), own_degree=0)
    factor, samples = ThinQR(columns.count + 1, BLOCK), 0
    for h, phi, u in _blocks(compensator, pairs):
        rows = factor.rows(len(u))
        columns.fill(rows, h, phi)
        rows[:, -1] = u
        factor.absorb(rows)
        samples += len(u)
    triangle, target = factor.triangle[:, :-1], factor.triangle[:, -1]
    size = np.linalg.norm(triangle, axis=0)
    size[size == 0] = 1.0
    solution, _, _, singular = np.linalg.lstsq(triangle / size, target, rcond=DEPENDENT)
    solution = solution / size
    rms_v = float(np.linalg.norm(triangle @ solution - target) / np.sqrt(samples))
    theta, _ = columns.weights(solution)
    with torch.no_grad():
        compensator.weights.theta.zero_()
        compensator.psi.zero_()
        compensator.weights.theta[:, : columns.functions] = torch.from_numpy(theta)
        if columns.has_offset:
            compensator.offset.fill_(solution[-1])
    nonzero = singular[singular > DEPENDENT * singular[0]]
    return rms_v, float(nonzero[0] / nonzero[-1])


def _blocks(
    compensator: DirectInverse, pairs: Sequence[InversePair]
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield play states, (rows, plays), rate functions, (functions, rows), and voltage, block by block."""
    for pair in pairs:
        state = None
        begin, stop, step = pair.counted.indices(pair.u.shape[1])
        for first in range(0, stop, BLOCK):
            stretch = slice(first, min(first + BLOCK, stop))
            with torch.no_grad():
                motion = Motion(*(part[:, stretch] for part in pair.motion))
                h, state = compensator.play_states(motion, state)
                basis = compensator.weights.basis(motion.yd_dot)
            counted = slice(max(begin - first, (begin - first) % step), None, step)
            yield h[0, counted].numpy(), basis[0, counted].numpy().T, pair.u[0, stretch][counted].numpy()
