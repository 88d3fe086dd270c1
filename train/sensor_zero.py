"""The zero of a sensor, where it is arbitrary: one number a record, found where nothing is judged."""

from collections.abc import Sequence

import torch
from scipy.optimize import minimize_scalar

from torchpi.control.direct_inverse import DirectInverse
from torchpi.identification import InversePair

SHARE = 0.1  # of the stroke, to either side: a zero is sought within it


def fit_zeros(compensator: DirectInverse, stretches: Sequence[InversePair]) -> list[float] | None:
    """For each record the zero, µm, with which its voltage fits best on the stretch; None without any."""
    return [fit_zero(compensator, pair) for pair in stretches] or None


def on_bound(zero_um: float, stretch: InversePair) -> bool:
    """Whether a fitted zero stands where the search for it ended: then it is none."""
    return abs(zero_um) > 0.999 * _reach_um(stretch)


def _reach_um(stretch: InversePair) -> float:
    return SHARE * float(stretch.motion.yd.max() - stretch.motion.yd.min())


def fit_zero(compensator: DirectInverse, stretch: InversePair) -> float:
    """The number within a tenth of the stroke that, taken off the displacement, makes the mean square of
    the voltage error least."""
    motion, u, counted = stretch.motion, stretch.u[:, stretch.counted], stretch.counted
    reach = _reach_um(stretch)

    def mean_square(zero_um: float) -> float:
        with torch.no_grad():
            predicted, _ = compensator.voltage(motion._replace(yd=motion.yd - zero_um))
        return float((predicted[:, counted] - u).square().mean())

    # A thousandth of a per cent of the stroke is far below any noise.
    found = minimize_scalar(
        mean_square, bounds=(-reach, reach), method="bounded", options={"xatol": 1e-4 * reach}
    )
    return float(found.x)
