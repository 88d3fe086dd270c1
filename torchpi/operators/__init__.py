"""Operators, one per file: a pure function with explicit state, a module on top of it, and a stream."""

from torchpi.operators.base import Operator
from torchpi.operators.chain import Chain
from torchpi.operators.play import PlayBank, play, play_bank
from torchpi.operators.polynomial import Polynomial, polynomial
from torchpi.operators.prandtl_ishlinskii import PrandtlIshlinskii
from torchpi.operators.quantization import Converter
from torchpi.operators.rate_weights import RateHead, RateWeights
from torchpi.operators.reference_filter import ReferenceFilter
from torchpi.operators.weighted_sum import weighted_sum

__all__ = [
    "Chain",
    "Converter",
    "Operator",
    "PlayBank",
    "Polynomial",
    "PrandtlIshlinskii",
    "RateHead",
    "RateWeights",
    "ReferenceFilter",
    "play",
    "play_bank",
    "polynomial",
    "weighted_sum",
]
