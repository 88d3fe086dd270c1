"""Damped Gauss–Newton over all parameters of a multi-axis stage, with exact tangents of its simulation."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from torchpi.operators.compiled import in_threads
from torchpi.operators.modal_feedback import DIVERGED, Constants, Parameters, modal_feedback, record_width
from torchpi.operators.modal_tangents import modal_gradient, modal_tangents
from torchpi.stage.multi_axis.stage import MultiAxisStage

STRIDE = 16
"""Samples per row of slopes that enters the normal matrix; the gradient uses all samples."""
BLOCK = 192
"""Number of tangents that are propagated together."""
RUN_IN = 0.25
"""Share of the preceding period over which slopes are propagated: longer than the memory of the modes."""
IN_MATRIX = 3
"""Periods in the normal matrix of a step; the next step takes others. The gradient uses all periods."""
REMEMBERED = 4
"""Number of steps over which the normal matrices are averaged."""
FIRST_DAMPING, LEAST_DAMPING = 1e-3, 1e-9
LESS, MORE = 8.0, 5.0
TRIALS = 8
PAIRS, RENEWED, BENT_DAMPING, MOST_DAMPING, SHORTER = 30, 30, 0.3, 1e4, 0.3
"""Quasi-Newton descent: number of pairs that it stores, steps after which the normal matrix is computed anew,
least and most damping of that matrix, and factor that shortens a step which does not lower the cost."""
FALL = 1e-4
"""Share of the decrease predicted by the slope that a step must reach."""
LARGEST_RADIUS, SMALLEST = 0.9995, 1e-12
"""Largest radius of a pole, and the smallest by which one is divided."""
STIFFEST = 1e6
"""Largest diagonal entry of a guard in the scaled normal matrix: beyond it, rounding would lose the rest."""
UNMOVED = 1e-9
"""Share of the largest slope below which a parameter counts as without effect."""

Pair = tuple[np.ndarray, np.ndarray]
"""A step of all parameters, and the change of the gradient along it."""


@dataclass(frozen=True, eq=False)
class Period:
    """One period of a periodic excitation in steady state, averaged over the recorded periods.

    Attributes:
        u: (samples, inputs), V.
        y: (samples, outputs), µm, about its mean.
        weight: Weight of its errors, 1/µm.
        before: Voltages of the preceding period, if they differ from `u`.
    """

    u: np.ndarray
    y: np.ndarray
    weight: float
    before: np.ndarray | None = None


class PeriodicFit:
    """Weighted mean squared error of a stage's steady state over periods, and its minimisation.

    The stage is simulated from rest through the preceding period. Tangents start in that period, `run_in`
    before its end, and those of guards at its beginning. A step after which a period has no bounded response
    is not taken. `others`, which weigh next to nothing until a stage rings, do not enter the normal matrix.
    """

    def __init__(
        self,
        stage: MultiAxisStage,
        periods: Sequence[Period],
        guards: Sequence[Period] = (),
        others: Sequence[Period] = (),
    ) -> None:
        self.stage, self.periods = stage, [*periods, *guards, *others]
        self.recorded, self.guards = len(periods), range(len(periods), len(periods) + len(guards))
        self.twice = [
            np.concatenate([one.u if one.before is None else one.before, one.u]) for one in self.periods
        ]
        self.excess = [stage.excess(u) for u in self.twice]
        # Zeros are appended for the future voltages on which the last displacements depend.
        self.padded = [np.pad(u, ((0, stage.shapes.ahead), (0, 0))) for u in self.twice]
        self.damping, self.run_in, self.in_matrix = FIRST_DAMPING, RUN_IN, IN_MATRIX

    def numbers(self) -> tuple[Parameters, Constants]:
        """Return the parameters and constants of the stage, as kernels take them."""
        return self.stage.kernel_parameters(), self.stage.thresholds_of_kernel()

    def vector(self) -> np.ndarray:
        """Return all parameters of the stage."""
        return np.concatenate([value.ravel() for value in self.stage.arrays().values()])

    def put(self, vector: np.ndarray) -> None:
        """Set the parameters of the stage, with poles outside the unit circle moved back into it.

        A mode that only its elements keep stable would ring by itself near rest, where they exert no force.
        """
        first = 0
        for value in self.stage.arrays().values():
            value[...] = vector[first : first + value.size].reshape(value.shape)
            first += value.size
        poles = self.stage.arrays()["poles"]
        poles *= np.minimum(1, LARGEST_RADIUS / np.maximum(np.hypot(*poles.T), SMALLEST))[:, None]

    def where(self, names: Sequence[str]) -> np.ndarray:
        """Return the indices, in `vector`, of the parameters with these names."""
        found, first = [], 0
        for name, value in self.stage.arrays().items():
            if name in names:
                found.append(np.arange(first, first + value.size))
            first += value.size
        return np.concatenate(found)

    def errors(self) -> list[np.ndarray] | None:
        """Return the error of each period, (samples, outputs), µm; None if a state diverges."""
        errors: list[np.ndarray | None] = [None] * len(self.periods)

        def run(first: int, last: int) -> None:
            for i in range(first, last):
                y = self._simulated(i)
                if y is not None:
                    left = self.periods[i].y - y[len(y) // 2 :]
                    errors[i] = left - left.mean(0)

        in_threads(run, len(self.periods))
        found = [error for error in errors if error is not None]
        return found if len(found) == len(errors) else None

    def cost(self, errors: Sequence[np.ndarray] | None) -> float:
        """Return the weighted mean squared error."""
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
        """Minimise the cost over the parameters with these names, and return it. Every step lowers it.

        Args:
            names: Names of the parameters.
            steps: Maximum number of steps.
            tolerance: Stop when a step lowers the cost by less than this share.
            goes_on: Called with the cost after each step; False stops the descent.
        """
        index, vector = self.where(names), self.vector()
        errors = self.errors()
        cost = self.cost(errors)
        gram = np.zeros((len(index), len(index)))
        for step in range(steps):
            if errors is None:
                break
            right = self.gradient(errors)[index]
            groups = self._groups()
            remembered = min(step + 1, REMEMBERED if groups > 1 else 1)
            made, guarded = self._normal_matrices(index, step % groups, groups)
            gram += (made - gram) / remembered
            unit, scale = scaled(gram, guarded)
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

    def descend_bent(self, goes_on: Callable[[float], bool]) -> float:
        """Minimise the cost over all parameters until no step lowers it, and return it.

        The valley of the cost is curved: long Gauss–Newton steps leave it, and short ones are slow. So the
            damped normal matrix only starts L-BFGS (Nocedal and Wright, Numerical Optimization, 2006,
            algorithm 7.4), which learns the curvature from gradients, each far quicker than a matrix.

        Args:
            goes_on: Called with the cost after each step; False stops the descent.
        """
        vector, errors = self.vector(), self.errors()
        if errors is None:
            return np.inf
        cost, right, pairs = self.cost(errors), self.gradient(errors), deque[Pair](maxlen=PAIRS)
        every, groups = np.arange(len(vector)), self._groups()
        gram, damping = np.zeros((len(vector), len(vector))), BENT_DAMPING
        renewed, age = 0, RENEWED
        while damping < MOST_DAMPING:
            if age == RENEWED:
                made, guarded = self._normal_matrices(every, renewed % groups, groups)
                renewed, age = renewed + 1, 0
                gram += (made - gram) / min(renewed, REMEMBERED)
                unit, scale = scaled(gram, guarded)
                factor = cho_factor(unit + damping * np.eye(len(vector)))
            way = quasi_newton(right, pairs, factor, scale)
            length, fell = 1.0, False
            for _ in range(TRIALS):
                self.put(vector + length * way)
                trial = self.errors()
                if fell := self.cost(trial) < cost - 2 * FALL * length * float(right @ way):
                    break
                length *= SHORTER
            if trial is None or not fell:
                # Close to a stage that rings by itself, the cost rises within less than any remembered step.
                self.put(vector)
                damping *= 1.0 if pairs else MORE
                pairs.clear()
                age = RENEWED
                continue
            moved, slope = self.vector(), self.gradient(trial)
            if (moved - vector) @ (right - slope) > 0:
                pairs.append((moved - vector, right - slope))
            vector, right, cost, age = moved, slope, self.cost(trial), age + 1
            damping = max(damping / LESS, BENT_DAMPING) if age == RENEWED else damping
            if not goes_on(cost):
                break
        return cost

    def gradient(self, errors: Sequence[np.ndarray]) -> np.ndarray:
        """Return the negative gradient of half the cost, for all parameters of the stage."""
        numbers = self.numbers()
        slopes = [Parameters(*map(np.zeros_like, numbers[0])) for _ in errors]

        def run(first: int, last: int) -> None:
            for i in range(first, last):
                record, began = self._record(i)
                error = errors[i] * (self.periods[i].weight ** 2 / errors[i].size / len(errors))
                modal_gradient(record, self.excess[i][began:], *numbers, began, error, slopes[i])

        in_threads(run, len(errors))
        each = []
        for i, (of_kernel, error) in enumerate(zip(slopes, errors, strict=True)):
            share = self.periods[i].weight ** 2 / error.size / len(errors)
            of_ahead = share * np.einsum("to,tij->oij", error, self._to_come(i))
            each.append(np.concatenate([value.ravel() for value in (*of_kernel, of_ahead)]))
        return np.asarray(np.sum(each, axis=0))

    def _groups(self) -> int:
        """Return the number of groups of periods, taken by strides: periods of one amplitude are adjacent."""
        return -(-self.recorded // self.in_matrix)

    def _normal_matrices(self, index: np.ndarray, start: int, stride: int) -> tuple[np.ndarray, np.ndarray]:
        """Return weighted normal matrices for these parameters: of every `stride`-th period, and of guards.

        Their sum is that of the cost. Where a stage begins to ring, the errors of guards outgrow all others
        within a step, so all guards are included in every step, in a matrix of their own.
        """
        # Slopes of `seen` and `direct` need no tangents of the states, those of `ahead` none at all.
        at_seen, at_ahead = self.where(["seen"])[0], len(self.vector()) - self.where(["ahead"]).size
        *sides, of_ahead = np.split(index, np.searchsorted(index, (at_seen, at_ahead)))
        blocks = [part for side in sides for part in np.split(side, range(BLOCK, len(side), BLOCK))]
        blocks = [block for block in blocks if len(block)]
        drawn = range(start, self.recorded, stride)
        chosen = [*drawn, *self.guards]
        grams: list[np.ndarray] = [np.zeros(0)] * len(chosen)
        numbers = self.numbers()

        def run(first: int, last: int) -> None:
            for at, i in enumerate(chosen[first:last], first):
                samples, outputs = self.periods[i].y.shape
                record, began = self._record(i)
                given = record, self.excess[i][began:], *numbers, began, samples, STRIDE
                every, done = np.zeros((samples // STRIDE, outputs, len(index))), 0
                for block in blocks:
                    here = slice(done, done := done + len(block))
                    slopes = np.zeros((samples // STRIDE, outputs, int(block[-1] - block[0]) + 1), np.float32)
                    modal_tangents(*given, int(block[0]), slopes)
                    every[:, :, here] = (slopes - slopes.mean(0))[:, :, block - block[0]]
                to_come = self._to_come(i).reshape(samples, -1)
                slopes = np.zeros((samples // STRIDE, outputs, outputs, to_come.shape[1]))
                for o in range(outputs):
                    slopes[:, o, o] = to_come[o % STRIDE :: STRIDE][: samples // STRIDE]
                slopes = slopes.reshape(len(slopes), outputs, -1)
                every[:, :, done:] = (slopes - slopes.mean(0))[:, :, of_ahead - at_ahead]
                rows = every.reshape(-1, len(index))
                grams[at] = rows.T @ rows * (self.periods[i].weight ** 2 / len(rows))

        in_threads(run, len(chosen))
        recorded = np.mean(grams[: len(drawn)], axis=0) * (self.recorded / len(self.periods))
        guarded = np.sum([np.zeros_like(recorded), *grams[len(drawn) :]], axis=0) / len(self.periods)
        return np.asarray(recorded), np.asarray(guarded)

    def _record(self, i: int) -> tuple[np.ndarray, int]:
        """Return the states that slopes need, from a sample of the preceding period on, and that sample."""
        samples = len(self.periods[i].u)
        # In a guard, ringing may persist from any part of the preceding period.
        began = samples - int((1.0 if i in self.guards else self.run_in) * samples)
        width = record_width(self.stage.shapes, len(self.stage.thresholds), len(self.stage.times_s))
        record = np.empty((2 * samples - began, width))
        self._simulated(i, record)
        return record, began

    def _simulated(self, i: int, record: np.ndarray | None = None) -> np.ndarray | None:
        """Simulate both periods, (time, outputs); None if a state diverges."""
        stage, u = self.stage, self.twice[i]
        state = stage.initial_state(1)
        y = np.zeros((len(u), stage.outputs))
        bounded = modal_feedback(
            u,
            self.excess[i],
            *self.numbers(),
            state.x[0],
            state.h[0],
            state.means[0],
            0,
            y,
            np.zeros((0, 0)) if record is None else record,
        )
        y += stage.foreseen(self.padded[i])
        return y if bounded and np.abs(y).max() < DIVERGED else None

    def _to_come(self, i: int) -> np.ndarray:
        """Return the voltages after each sample of the counted period, (samples, inputs, ahead)."""
        u, samples = self.padded[i], len(self.periods[i].u)
        after = samples + np.arange(samples)[:, None] + np.arange(1, self.stage.shapes.ahead + 1)
        return np.asarray(u[after].swapaxes(1, 2))


def quasi_newton(
    right: np.ndarray, pairs: Sequence[Pair], factor: tuple[np.ndarray, bool], scale: np.ndarray
) -> np.ndarray:
    """Return the step of L-BFGS for a negative gradient.

    Args:
        right: The negative gradient.
        pairs: Pairs of previous steps, the newest last.
        factor: Cholesky factor, from `cho_factor`, of the initial matrix.
        scale: Vector by which that matrix is still to be multiplied on either side.
    """
    way, shares = right.copy(), []
    for moved, change in reversed(pairs):
        shares.append((moved @ way) / (moved @ change))
        way -= shares[-1] * change
    way = cho_solve(factor, way / scale) / scale
    for (moved, change), share in zip(pairs, reversed(shares), strict=True):
        way += moved * (share - (change @ way) / (moved @ change))
    return np.asarray(way)


def scaled(gram: np.ndarray, guarded: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the sum of two normal matrices, scaled, and the vector that divides it on either side.

    The scaling makes the diagonal of the first 1, so damping is relative to it, whatever a guard's slopes.
    """
    scale = np.sqrt(np.diag(gram))
    scale = np.maximum(scale, UNMOVED * scale.max())
    stiff = guarded / scale / scale[:, None]
    stiff *= min(1.0, STIFFEST / max(float(np.diag(stiff).max()), 1.0))
    return np.asarray(gram / scale / scale[:, None] + stiff), scale
