"""Fit all parameters jointly: the weights are solved for, the rest searched by damped Gauss–Newton."""

from collections.abc import Sequence

from torch import nn

from torchpi.control.direct_inverse import DirectInverse
from torchpi.identification.pair import InversePair
from torchpi.identification.projected_problem import ProjectedProblem
from torchpi.identification.projection import RIDGE, linear_parameters
from torchpi.identification.search import search


def fit_joint(compensator: DirectInverse, pairs: Sequence[InversePair], evaluations: int = 150) -> float:
    """Improve `compensator` in place over whole records, from its current state; return the rms error, V.

    The search descends from that state and from several scales of the polynomial. `torchpi train fit` does
    the same with validation, checkpoints and pictures.

    Args:
        compensator: Changed in place.
        pairs: Records, made with the compensator's preview.
        evaluations: Maximum number of trials of each descent; one costs two or three passes over the records.
    """
    problem = joint_problem(compensator, pairs)
    alpha, solved = search(problem, evaluations, thorough=True)
    problem.put(alpha, solved.beta)
    return float(solved.mean_square**0.5)


def joint_problem(compensator: DirectInverse, pairs: Sequence[InversePair]) -> ProjectedProblem:
    """Return the problem in lead, creep gains, polynomial, thresholds and neural head, as far as trainable.

    The weights are solved for at each trial.
    """
    trainable = {
        "lead": compensator.scaled_lead,
        "gains": compensator.creep_gains,
        "c": compensator.saturation.scaled,
        "r": compensator.plays.raw_thresholds,
        "slope": compensator.weights.slope,
        "shift": compensator.weights.shift,
    }
    return ProjectedProblem(
        compensator,
        pairs,
        [name for name, parameter in trainable.items() if parameter.requires_grad],
        functions=compensator.weights.theta.shape[1],
        own_degree=compensator.psi.shape[1],
        ridge=RIDGE,
    )


def searched_parameters(compensator: DirectInverse, weights_are_solved: bool) -> list[nn.Parameter]:
    """Return the trainable parameters, without those that least squares solves for at each trial.

    Args:
        compensator: The compensator to train.
        weights_are_solved: Whether each trial solves for the weights by least squares.
    """
    solved = {id(part) for part in linear_parameters(compensator)} if weights_are_solved else set()
    return [
        parameter
        for parameter in compensator.parameters()
        if parameter.requires_grad and parameter.numel() > 0 and id(parameter) not in solved
    ]
