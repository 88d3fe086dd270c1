"""Random walks in what a fit leaves: of the gain, or of an added signal.

    e(k) = g(k) x(k) + a(k) + Σ c_j φ_j(k) + noise,

with random walks g of the displacement's gain and a of the zero. The φ_j are in every model, so that what
follows the motion, or ages, is no walk. Kalman filters predict e one step ahead and compare the walks
(Harvey, *Forecasting, Structural Time Series Models and the Kalman Filter*, 1989, 3.4).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import log

import numpy as np
from scipy.optimize import minimize

from torchpi.diagnosis.long_recordings import means
from torchpi.operators.compiled import njit

CELLS = 20
"""Number of stretches of each recording over which models are compared; the first only determines the
constants."""
DIFFUSE = 1e8
"""Prior variance of a constant coefficient, in multiples of the noise's."""
STARTS = (-6.0, 2.0)
"""Log variances of a walk's step, over that of the noise, from which the best is sought."""


@dataclass(frozen=True, eq=False)
class Left:
    """What a fit leaves of one recording, in units of the travel, as means over equal numbers of samples."""

    e: np.ndarray
    """(time,): the residual, NaN where it does not count."""
    rows: np.ndarray
    """(time, 2 + constants): what g, a and each c_j multiply."""
    period_s: float

    @property
    def x(self) -> np.ndarray:
        """(time,): the displacement that the fit predicts, which g multiplies."""
        return self.rows[:, 0]

    @classmethod
    def of(cls, e: np.ndarray, counts: np.ndarray, rows: np.ndarray, factor: int, period_s: float) -> "Left":
        """Return a residual where it counts, (time,) of bool, as means over `factor` samples, beside the rows
        of these means and of any later ones, (means, 2 + constants)."""
        part = means(counts, factor)
        mean = means(np.where(counts, e, 0.0), factor) / np.maximum(part, 1e-300)
        return cls(np.where(part > 0, mean, np.nan), rows[: len(part)], factor * period_s)


@dataclass(frozen=True, eq=False)
class Walks:
    """A model of what is left: a walk of the gain, of an added signal, or both."""

    gain_step: float
    added_step: float
    """Variances of a walk's step, over that of the noise; with several rates, at the highest."""
    nats: float
    cells: np.ndarray
    """(cells,): log densities."""
    predicted: float
    """Share of the residual's mean square that it predicts one step ahead."""
    adds: tuple[np.ndarray, ...]
    """(time,) for each recording: the prediction."""

    @classmethod
    def of(cls, left: Sequence[Left], noise: float, gain_step: float, added_step: float) -> "Walks":
        """Return the model whose walks have these steps; the variance of the noise is at least `noise`."""
        shortest_s = min(one.period_s for one in left)
        longer = [one.period_s / shortest_s for one in left]
        found = [
            filtered(one.e, one.rows, gain_step * steps, added_step * steps)
            for one, steps in zip(left, longer, strict=True)
        ]
        variance, error = zip(*found, strict=True)
        counts = [one > 0 for one in variance]
        scaled = [v[n] ** 2 / s[n] for v, s, n in zip(error, variance, counts, strict=True)]
        of_noise = max(float(np.mean(np.concatenate(scaled))), noise)
        nats = [np.zeros(len(n)) for n in counts]
        for one, s, v, n in zip(nats, variance, scaled, counts, strict=True):
            one[n] = -0.5 * (np.log(of_noise * s[n]) + v / of_noise)
        cells = np.array([float(cell.sum()) for one in nats for cell in np.array_split(one, CELLS)])
        missed, whole = (
            sum(float(np.sum(each[n] ** 2)) for each, n in zip(signal, counts, strict=True))
            for signal in (error, [one.e for one in left])
        )
        return cls(
            gain_step,
            added_step,
            float(cells.sum()),
            cells,
            max(1.0 - missed / max(whole, 1e-300), 0.0),
            tuple(np.where(n, one.e - v, 0.0) for one, v, n in zip(left, error, counts, strict=True)),
        )

    @classmethod
    def best(
        cls, left: Sequence[Left], noise: float, starts: Sequence[tuple[float | None, float | None]]
    ) -> "Walks":
        """Return the most likely model, sought from these logs of the steps of gain and added signal. Where
        one is None, there is no such walk."""
        walking = [one is not None for one in starts[0]]

        def model(log: np.ndarray) -> "Walks":
            steps = np.zeros(2)
            steps[walking] = np.exp(log)
            return cls.of(left, noise, float(steps[0]), float(steps[1]))

        found = [
            minimize(
                lambda log: -model(log).nats,
                [one for one in start if one is not None],
                method="Nelder-Mead",
                options={"xatol": 0.1, "fatol": 0.5, "maxfev": 60},
            )
            for start in starts
        ]
        return model(min(found, key=lambda one: float(one.fun)).x)


@dataclass(frozen=True, eq=False)
class Comparison:
    """The most likely walk of the gain, and of an added signal, in what is left."""

    left: Sequence[Left]
    noise: float
    """Least variance of the noise."""
    of_gain: Walks
    added: Walks

    @classmethod
    def of(cls, left: Sequence[Left], noise: float) -> "Comparison":
        of_gain, added = (
            Walks.best(left, noise, starts)
            for starts in ([(one, None) for one in STARTS], [(None, one) for one in STARTS])
        )
        return cls(left, noise, of_gain, added)

    def evidence_of_gain(self) -> float:
        """Return the share, 0–1, of the evidence for a walk of the gain, of that for either walk beside the
        other."""
        of_gain, added = log(self.of_gain.gain_step), log(self.added.added_step)
        starts = [(of_gain, added + STARTS[0]), (of_gain + STARTS[0], added)]
        both = Walks.best(self.left, self.noise, starts)
        needs_gain, needs_added = (max(both.nats - one.nats, 0.0) for one in (self.added, self.of_gain))
        return needs_gain / max(needs_gain + needs_added, 1e-300)


@njit
def filtered(
    e: np.ndarray,  # (time,), NaN where there is none
    rows: np.ndarray,  # (time, states), of which the first two walk
    gain_step: float,
    added_step: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return, (time,) each, the variance of each prediction one step ahead over that of the noise, and its
    error; the variance is 0 where nothing is predicted, as in the first stretch, which determines the
    constants."""
    time, states = rows.shape
    relative, error = np.zeros(time), np.zeros(time)
    state, covariance = np.zeros(states), np.zeros((states, states))
    for j in range(2, states):
        covariance[j, j] = DIFFUSE
    seen = 0
    for t in range(time):
        covariance[0, 0] += gain_step
        covariance[1, 1] += added_step
        if np.isnan(e[t]):
            continue
        row = rows[t]
        to_row = np.sum(covariance * row, axis=1)
        variance = 1.0 + np.sum(to_row * row)
        off = e[t] - np.sum(state * row)
        seen += 1
        if seen > max(states, time // CELLS):
            relative[t], error[t] = variance, off
        state += to_row * (off / variance)
        covariance -= np.outer(to_row, to_row) / variance
    return relative, error
