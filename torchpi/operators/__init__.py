"""Operators, one a file: a pure function with explicit state, a module on top, a stream."""

from torchpi.operators.base import Operator
from torchpi.operators.creep import Creep
from torchpi.operators.delay import Delay
from torchpi.operators.held_lag import HeldLag
from torchpi.operators.lag import Lag
from torchpi.operators.limits import Clip
from torchpi.operators.mode import Mode
from torchpi.operators.play import PlayBank, play, play_bank
from torchpi.operators.polynomial import Polynomial, polynomial
from torchpi.operators.prandtl_ishlinskii import PrandtlIshlinskii
from torchpi.operators.quantization import Quantization
from torchpi.operators.rate_weights import RateHead, RateWeights
from torchpi.operators.reference_filter import ReferenceFilter
from torchpi.operators.weighted_sum import weighted_sum

__all__ = [
    "Clip",
    "Creep",
    "Delay",
    "HeldLag",
    "Lag",
    "Mode",
    "Operator",
    "PlayBank",
    "Polynomial",
    "PrandtlIshlinskii",
    "Quantization",
    "RateHead",
    "RateWeights",
    "ReferenceFilter",
    "play",
    "play_bank",
    "polynomial",
    "weighted_sum",
]
