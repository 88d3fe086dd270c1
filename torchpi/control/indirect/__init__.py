"""Methods that the direct inverse is compared with, one per file: inverted models of the stage.

All but the last identify a forward hysteresis, voltage to displacement, and invert it in closed form; the
generalised direct inverse is a direct one with richer plays. All are deployed like `DirectInverse`:
`inverse(motion)` for records, `inverse.stream()` for a control loop.
"""

from torchpi.control.indirect.base import IndirectInverse
from torchpi.control.indirect.cascade import CascadedInverse, lead_of
from torchpi.control.indirect.conventional import ConventionalInverse, conventional_inverse
from torchpi.control.indirect.generalised_direct import GeneralisedDirectInverse
from torchpi.control.indirect.rate_dependent import RateDependentInverse
from torchpi.control.indirect.time_varying_thresholds import (
    Dilation,
    TimeVaryingThresholdInverse,
    TimeVaryingThresholdPI,
    dilation,
)

__all__ = [
    "CascadedInverse",
    "ConventionalInverse",
    "Dilation",
    "GeneralisedDirectInverse",
    "IndirectInverse",
    "RateDependentInverse",
    "TimeVaryingThresholdInverse",
    "TimeVaryingThresholdPI",
    "conventional_inverse",
    "dilation",
    "lead_of",
]
