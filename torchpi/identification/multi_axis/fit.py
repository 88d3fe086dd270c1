"""Damped Gauss–Newton over all numbers of a stage of several axes, by exact tangents of its simulation."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from torchpi.operators.compiled import in_threads
from torchpi.operators.modal_feedback import DIVERGED, modal_feedback
from torchpi.stage.multi_axis.stage import MultiAxisStage

STRIDE = 8
"""Every how many samples a row of slopes goes into the normal matrix; the gradient is of all samples."""
BLOCK = 256
"""Tangents that are carried together."""
FIRST_DAMPING, LEAST_DAMPING = 1e-3, 1e-9
LESS, MORE = 8.0, 5.0
TRIALS = 8
LARGEST_RADIUS, SMALLEST = 0.9995, 1e-12
"""Of a pole."""
UNMOVED = 1e-9
"""Of the largest slope: a number with less moves nothing."""


@dataclass(frozen=True, eq=False)
class Period:
    """One period of a periodic excitation in steady state, the mean of those recorded.

    Attributes:
        u: (samples, inputs), V.
        y: (samples, outputs), µm, about its mean.
        weight: Of its errors, 1/µm.
    """

    u: np.ndarray
    y: np.ndarray
    weight: float


class PeriodicFit:
    """Weighted mean squared error of a stage's steady state over periods, and its descent.

    The stage runs through the period before, from rest; tangents begin with it as well. Feedback that is
    stable for some voltages may not be for others: no step is taken after which one of the `guards`,
    voltages of a period (samples, inputs), has no bounded answer.
    """

    def __init__(
        self, stage: MultiAxisStage, periods: Sequence[Period], guards: Sequence[np.ndarray] = ()
    ) -> None:
        self.stage, self.periods = stage, list(periods)
        self.twice = [np.concatenate([u, u]) for u in [*(one.u for one in periods), *guards]]
        self.excess = [stage.excess(u) for u in self.twice]
        self.damping = FIRST_DAMPING

    def vector(self) -> np.ndarray:
        """All numbers of the stage."""
        return np.concatenate([value.ravel() for value in self.stage.arrays().values()])

    def put(self, vector: np.ndarray) -> None:
        """Give the stage these numbers, poles outside the unit circle brought back into it.

        A mode that only its elements keep stable would ring by itself near rest, where they have no force.
        """
        first = 0
        for value in self.stage.arrays().values():
            value[...] = vector[first : first + value.size].reshape(value.shape)
            first += value.size
        poles = self.stage.arrays()["poles"]
        poles *= np.minimum(1, LARGEST_RADIUS / np.maximum(np.hypot(*poles.T), SMALLEST))[:, None]

    def where(self, names: Sequence[str]) -> np.ndarray:
        """Indices in the vector of the parameters of these names."""
        found, first = [], 0
        for name, value in self.stage.arrays().items():
            if name in names:
                found.append(np.arange(first, first + value.size))
            first += value.size
        return np.concatenate(found)

    def errors(self) -> list[np.ndarray] | None:
        """(samples, outputs) for each period, µm; None where a state leaves all bounds, a guard's too."""
        errors: list[np.ndarray | None] = [None] * len(self.twice)

        def run(first: int, last: int) -> None:
            for i in range(first, last):
                y = self._simulated(i, 0, np.zeros((0, 0)))
                if y is not None:
                    left = (self.periods[i].y if i < len(self.periods) else 0.0) - y[len(y) // 2 :]
                    errors[i] = left - left.mean(0)

        in_threads(run, len(self.twice))
        if any(error is None for error in errors):
            return None
        return [error for error in errors[: len(self.periods)] if error is not None]

    def cost(self, errors: Sequence[np.ndarray] | None) -> float:
        """Weighted mean squared error."""
        if errors is None:
            return np.inf
        weighted = [(one.weight * e) ** 2 for one, e in zip(self.periods, errors, strict=True)]
        return float(np.mean([w.mean() for w in weighted]))

    def descend(
        self,
        names: Sequence[str],
        steps: int,
        tolerance: float = 4e-4,
        goes_on: Callable[[float], bool] = lambda cost: True,
    ) -> float:
        """Move the parameters of these names downhill; returns the cost. Every step lowers it.

        Args:
            names: Of the parameters.
            steps: At most.
            tolerance: Relative fall of a step that ends it.
            goes_on: Called with the cost after each step; False ends it.
        """
        index, vector = self.where(names), self.vector()
        errors = self.errors()
        cost = self.cost(errors)
        for _ in range(steps):
            if errors is None:
                break
            gram, right = self._normal_equations(index, errors)
            scale = np.sqrt(np.diag(gram))
            scale = np.maximum(scale, UNMOVED * scale.max())
            unit = gram / scale / scale[:, None]
            before, fell = cost, False
            for _ in range(TRIALS):
                damped = unit + self.damping * np.eye(len(index))
                moved = vector.copy()
                moved[index] += np.linalg.solve(damped, right / scale) / scale
                self.put(moved)
                moved = self.vector()
                trial = self.errors()
                if fell := self.cost(trial) < cost:
                    vector, errors, cost = moved, trial, self.cost(trial)
                    self.damping = max(self.damping / LESS, LEAST_DAMPING)
                    break
                self.damping *= MORE
            self.put(vector)
            if not fell or before - cost < tolerance * before or not goes_on(cost):
                break
        self.damping = min(max(self.damping, LEAST_DAMPING), 1e-2)
        return cost

    def _normal_equations(
        self, index: np.ndarray, errors: Sequence[np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """The weighted normal matrix and gradient for the parameters at these indices."""
        # Slopes of `seen` and `direct` need no tangents of the states.
        sides = np.split(index, [np.searchsorted(index, self.where(("seen", "direct"))[0])])
        blocks = [part for side in sides for part in np.split(side, range(BLOCK, len(side), BLOCK))]
        blocks = [block for block in blocks if len(block)]
        grams: list[np.ndarray] = [np.zeros(0)] * len(self.periods)
        rights: list[np.ndarray] = [np.zeros(0)] * len(self.periods)

        def run(first: int, last: int) -> None:
            for i in range(first, last):
                samples, outputs = errors[i].shape
                gradient, every = np.zeros(len(index)), np.zeros((samples // STRIDE, outputs, len(index)))
                done = 0
                for block in blocks:
                    here = slice(done, done := done + len(block))
                    size = int(block[-1] - block[0]) + 1
                    part, total = np.zeros(size), np.zeros((outputs, size))
                    slopes = np.zeros((samples // STRIDE, outputs, size))
                    self._simulated(i, samples, errors[i], int(block[0]), part, total, slopes)
                    gradient[here] = part[block - block[0]]
                    every[:, :, here] = (slopes - total / samples)[:, :, block - block[0]]
                centred = every.reshape(-1, len(index))
                share = self.periods[i].weight ** 2 / (samples * outputs)
                grams[i] = centred.T @ centred * (STRIDE * share)
                rights[i] = gradient * share

        in_threads(run, len(self.periods))
        return np.sum(grams, axis=0), np.sum(rights, axis=0)

    def _simulated(
        self,
        i: int,
        counted: int,
        error: np.ndarray,
        low: int = 0,
        gradient: np.ndarray | None = None,
        total: np.ndarray | None = None,
        slopes: np.ndarray | None = None,
    ) -> np.ndarray | None:
        """Both periods, (time, outputs); None where a state leaves all bounds."""
        stage, u = self.stage, self.twice[i]
        state = stage.initial_state(1)
        y = np.zeros((len(u), stage.outputs))
        every = np.concatenate([np.zeros((counted, error.shape[1])), error])
        nothing = (np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0, 0)))
        carried = nothing if gradient is None else (gradient, total, slopes)
        bounded = modal_feedback(
            u, self.excess[i], *stage.arrays().values(), *stage.thresholds_of_kernel(),
            state.x[0], state.h[0], state.means[0], 0, y, 0, counted, every, STRIDE, low, *carried,
        )  # fmt: skip
        return y if bounded and np.abs(y).max() < DIVERGED else None
