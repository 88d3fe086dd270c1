"""The conventional inverse: a rate-independent Prandtl–Ishlinskii model, inverted exactly.

Krejčí and Kuhnen, *Inverse control of systems with hysteresis and creep*, IEE Proc. Control Theory Appl.
148(3), 2001; with dead zones before it, the inverse of the modified operator of Kuhnen, European J. Control
9(4), 2003. Fig. 2 and 3 of Qin et al. (2013) are of this kind. It ignores the rate.
"""

from torchpi.control.indirect.base import IndirectInverse
from torchpi.control.indirect.inversion_law import inverse_numbers
from torchpi.operators.prandtl_ishlinskii import PrandtlIshlinskii


def conventional_inverse(operator: PrandtlIshlinskii) -> PrandtlIshlinskii:
    """Return the inverse of `operator`, which is of the same kind: thresholds and weights in closed form.

    Args:
        operator: Thresholds in V and weights in µm/V if it is the hysteresis of a stage.

    Raises:
        ConfigError: Thresholds that do not rise from 0, or a slope that is not positive.

    Example:
        >>> from torchpi import PrandtlIshlinskii
        >>> from torchpi.control.indirect import conventional_inverse
        >>> inverse = conventional_inverse(PrandtlIshlinskii([0.0, 1.0], [0.5, 0.5]))  # V, µm/V
        >>> (inverse.plays.r.tolist(), inverse.w.tolist())  # µm, V/µm
        ([0.0, 0.5], [2.0, -1.0])
    """
    return PrandtlIshlinskii(*inverse_numbers(operator.plays.r.tolist(), operator.w.tolist()))


class ConventionalInverse(IndirectInverse):
    """The exact inverse of y = S(Σ_i w_i H_ri[u]), as a compensator: no slopes, no lead."""
