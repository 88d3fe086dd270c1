"""The arbitrary zero of a sensor: one number per record, fitted on samples that are not judged."""

from collections.abc import Sequence

import torch
from scipy.optimize import minimize_scalar

from torchpi.control.direct_inverse import DirectInverse
from torchpi.identification import InversePair

SHARE = 0.1  # a zero is searched within this fraction of the stroke, to either side


def fit_zeros(compensator: DirectInverse, stretches: Sequence[InversePair]) -> list[float] | None:
    """Return for each record the zero, µm, that fits its voltage best on the stretch; None without any."""
    return [fit_zero(compensator, pair) for pair in stretches] or None


def on_bound(zero_um: float, stretch: InversePair) -> bool:
    """Whether a fitted zero lies at the bound of its search, so that it is not valid."""
    return abs(zero_um) > 0.999 * _reach_um(stretch)


def _reach_um(stretch: InversePair) -> float:
    return SHARE * float(stretch.motion.yd.max() - stretch.motion.yd.min())


def fit_zero(compensator: DirectInverse, stretch: InversePair) -> float:
    """Return the offset, within a tenth of the stroke, whose subtraction from the displacement minimises
    the mean squared voltage error."""
    motion, u, counted = stretch.motion, stretch.u[:, stretch.counted], stretch.counted
    reach = _reach_um(stretch)

    def mean_square(zero_um: float) -> float:
        with torch.no_grad():
            predicted, _ = compensator.voltage(motion._replace(yd=motion.yd - zero_um))
        return float((predicted[:, counted] - u).square().mean())

    # The tolerance, a thousandth of a per cent of the stroke, is far below any noise.
    found = minimize_scalar(
        mean_square, bounds=(-reach, reach), method="bounded", options={"xatol": 1e-4 * reach}
    )
    return float(found.x)
