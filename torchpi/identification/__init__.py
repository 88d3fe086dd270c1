"""Identification of the direct inverse from recordings: the paper's two stages, and the errors of a fit."""

from torchpi.identification.inverse_errors import InverseErrors, inverse_errors, local_slope
from torchpi.identification.joint import fit_joint, searched_parameters
from torchpi.identification.pair import InversePair, inverse_pair
from torchpi.identification.two_stage import TwoStageResult, fit_two_stage

__all__ = [
    "InverseErrors",
    "InversePair",
    "TwoStageResult",
    "fit_joint",
    "fit_two_stage",
    "inverse_errors",
    "inverse_pair",
    "local_slope",
    "searched_parameters",
]
