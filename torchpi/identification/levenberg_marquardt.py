"""Damped Gauss–Newton (Levenberg 1944, Marquardt 1963; scaling by Moré 1978, damping by Nielsen 1999)."""

from collections import deque

import numpy as np

from torchpi.identification.projected_problem import ProjectedProblem, Solved
from torchpi.identification.thin_qr import solve_triangle, triangle_of

FIRST_DAMPING = 1e-3
PATIENCE = 6  # trials over which convergence is judged
ROOM = 10.0  # factor by which a descent may exceed the decrease that the linearisation predicts


def levenberg_marquardt(
    problem: ProjectedProblem, alpha: np.ndarray, evaluations: int, tolerance: float, best: float = np.inf
) -> tuple[np.ndarray, Solved]:
    """Minimise from `alpha`; return α and the weights there. The objective never rises.

    Args:
        problem: The problem to minimise.
        alpha: Starting point.
        evaluations: Maximum number of trials.
        tolerance: Stop when the objective has fallen by less than this share over `PATIENCE` trials: at its
            kinks, where a play just begins to move, a descent would creep on without end.
        best: Objective that another descent has reached. This one gives up if it is unlikely to fall below
            it: if even `ROOM` times the decrease that the linearisation predicts at most is too little.
    """
    solved = problem.solve(alpha)
    scale = np.zeros(len(alpha))
    damping, growth = FIRST_DAMPING, 4.0
    linearised = None
    lately = deque([np.inf] * PATIENCE)
    for _ in range(evaluations if len(alpha) > 0 else 0):
        if linearised is None:
            linearised = problem.linearise(alpha, solved.beta)
            scale = np.maximum(scale, np.sqrt(np.square(linearised.slopes).sum(0)))
            scale[scale == 0] = 1.0  # a parameter without effect
            reachable = float(linearised.error @ linearised.error)
            if solved.objective - ROOM * reachable > (1 - tolerance) * best:
                break
        slopes, error = linearised.slopes / scale, linearised.error
        step = _damped_step(slopes, error, damping)
        left = error - slopes @ step
        expected = float(error @ error - left @ left)
        if expected <= 0.1 * tolerance * solved.objective:
            break
        trial = problem.moved(alpha, step / scale)
        tried = problem.solve(trial)
        fall = solved.objective - tried.objective
        if fall > 0:
            damping *= max(1 / 10, 1 - (2 * fall / expected - 1) ** 3)
            growth = 4.0
            alpha, solved, linearised = trial, tried, None
        else:
            damping *= growth
            growth *= 4.0
        lately.append(solved.objective)
        if lately.popleft() - solved.objective <= tolerance * solved.objective:
            break
    return alpha, solved


def _damped_step(slopes: np.ndarray, error: np.ndarray, damping: float) -> np.ndarray:
    """Return argmin |slopes · δ - error|² + damping |δ|²."""
    n = len(error)
    both = np.zeros((2 * n + 1, n + 1))
    both[:n, :n], both[:n, n] = slopes, error
    both[n + np.arange(n), np.arange(n)] = np.sqrt(damping)
    triangle = triangle_of(both)
    return solve_triangle(triangle[:n, :n], triangle[:n, n])
