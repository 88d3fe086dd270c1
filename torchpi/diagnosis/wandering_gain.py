"""A gain that wanders: whether what a fit leaves is the displacement times a slow signal of its own.

A gain that changes at no fixed frequency has too many numbers to be fitted beside other effects, and one that
may take any shape would absorb whatever is slow. It is therefore read off the final residual,

    e(k) = g(k) x(k) + a(k) + Σ c_j φ_j(k) + noise,

with random walks g and a. The φ_j, such as powers of the displacement x, and x times its speed or time, are
in every model, so that a gain which follows the motion, or ages, is none that wanders. Kalman filters
(Harvey, *Forecasting, Structural Time Series Models and the Kalman Filter*, 1989, 3.4) compare the walks: a
gain needs no added signal beside it, and no added signal can take its place.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize

from torchpi.diagnosis.contest import ACCEPTED, PRIOR
from torchpi.diagnosis.decide import NAMED, Decision
from torchpi.diagnosis.diagnosis import NamedEffect, Parameter
from torchpi.diagnosis.hypothesis import Fit
from torchpi.diagnosis.long_recordings import means
from torchpi.diagnosis.noise import Noise
from torchpi.diagnosis.posterior import trust
from torchpi.diagnosis.records import Record
from torchpi.diagnosis.score import gain
from torchpi.diagnosis.sealed import mean_square
from torchpi.operators.compiled import njit
from torchpi.stage.effects.sensor.gain_modulation import GainModulation

AT_MOST = 3000
"""Number of means of each recording from which a filter starts to cost more than it shows."""
CELLS = 20
"""Number of stretches of each recording over which a gain must be better than an added signal; the first only
determines the constants."""
LAGS = 2 ** np.arange(6)
"""Samples back from which the motion may predict a residual."""
DIFFUSE = 1e8
"""Prior variance of a constant coefficient, in multiples of the noise's."""
LEAST_NOISE = 1e-16
"""Variance of the noise below which none is assumed, over that of the travel."""
STARTS = (-6.0, 2.0)
"""Log variances of a walk's step, over that of the noise, from which the best is sought."""


@dataclass(frozen=True, eq=False)
class Left:
    """What a fit leaves of one recording, in units of the travel."""

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
    def of(
        cls, record: Record, residual: np.ndarray, counts: np.ndarray, span_um: float, factor: int
    ) -> "Left":
        """Return it for one recording and its residual, (time,), µm, where that counts, (time,) of bool, as
        means over `factor` samples."""
        part = means(counts, factor)
        e = np.where(part > 0, means(np.where(counts, residual, 0.0), factor), np.nan)
        e /= span_um * np.maximum(part, 1e-300)
        x = means(record.y - residual, factor) / span_um
        from_middle, about = x - x.mean(), max(len(x) // (2 * CELLS), 5)
        level = uniform_filter1d(from_middle, about)
        amplitude, speed = (
            np.sqrt(np.maximum(uniform_filter1d(square, about), 0.0))
            for square in ((from_middle - level) ** 2, np.gradient(x) ** 2)
        )
        speed /= max(float(speed.max()), 1e-300)
        along = np.linspace(-1.0, 1.0, len(x))
        of_gain = (np.ones_like(x), from_middle, amplitude, level, speed, along)
        rows = [x, np.ones_like(x), np.ones_like(x), *(from_middle * one for one in of_gain)]
        return cls(e, np.stack(rows, axis=1), factor * record.period_s)


@dataclass(frozen=True, eq=False)
class Walks:
    """A model of what is left: a walk of the gain, of an added signal, or both."""

    nats: float
    cells: np.ndarray
    """(cells,): log densities."""
    predicted: float
    """Share of the residual's mean square that it predicts one step ahead."""
    adds: tuple[np.ndarray, ...]
    """(time,) for each recording: the prediction."""

    @classmethod
    def of(cls, left: Sequence[Left], noise: float, gain_step: float, added_step: float) -> "Walks":
        """Return the model whose walks have steps of these variances, over that of the noise, which is at
        least `noise`; with several rates, the steps are those at the highest."""
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
            float(cells.sum()),
            cells,
            1.0 - missed / max(whole, 1e-300),
            tuple(np.where(n, one.e - v, 0.0) for one, v, n in zip(left, error, counts, strict=True)),
        )

    @classmethod
    def best(
        cls,
        left: Sequence[Left],
        noise: float,
        steps: Callable[[np.ndarray], tuple[float, float]],
        starts: Sequence[Sequence[float]],
    ) -> tuple["Walks", np.ndarray]:
        """Return the most likely model, and the logs that `steps` turns into its variances."""
        found = [
            minimize(
                lambda log: -cls.of(left, noise, *steps(np.exp(log))).nats,
                start,
                method="Nelder-Mead",
                options={"xatol": 0.1, "fatol": 0.5, "maxfev": 60},
            )
            for start in starts
        ]
        log: np.ndarray = min(found, key=lambda one: float(one.fun)).x
        return cls.of(left, noise, *steps(np.exp(log))), log


def with_wandering_gain(
    decision: Decision, records: Sequence[Record], retuned: Fit, final: Fit, noise: Noise | None
) -> tuple[Decision, list[np.ndarray]]:
    """Name a wandering gain that the residual shows, and return what it adds to each recording, (time,), µm.
    No stage can predict it from the voltage, so it explains its share, but the verdict is not "explained"."""
    if GainModulation.name in {one.name for one in decision.effects}:
        return decision, []
    effect, adds = wandering_gain(records, final, noise.rms_um if noise is not None else 0.0)
    if effect.probability < NAMED:
        return decision, []
    # Where the noise was not measured, nothing of what is left counts as unexplained yet.
    measured = noise is not None
    left = decision.unexplained_share if measured else (final.train_rms / retuned.train_rms) ** 2
    share = left * effect.share
    others = [replace(one, share=one.share * (1.0 if measured else 1.0 - share)) for one in decision.effects]
    named = replace(
        decision,
        verdict="partly_explained",
        effects=tuple(sorted([*others, replace(effect, share=share)], key=lambda one: -one.share)),
        open=tuple(one for one in decision.open if one.name != effect.name),
        unexplained_share=decision.unexplained_share * (1.0 - effect.share),
    )
    return named, adds


def wandering_gain(
    records: Sequence[Record], final: Fit, noise_um: float
) -> tuple[NamedEffect, list[np.ndarray]]:
    """Return a wandering gain with its probability and its share of what a fit leaves, and what it adds to
    each recording, (time,), µm.

    Its share of the residual, that of the evidence for either walk, and the share of the residual that the
    motion does not predict have to be large together: a misfit of any kind has some of each.

    Args:
        records: The recordings.
        final: The fit whose residuals are examined.
        noise_um: The noise of a reading, 0 if it was not measured.
    """
    span_um = max(float(np.ptp(record.y)) for record in records)
    factor = max(1, max(len(record.y) for record in records) // AT_MOST)
    each = list(zip(records, final.residuals, strict=True))
    left = [Left.of(r, e, r.train, span_um, factor) for r, e in each]
    noise = max((noise_um / span_um) ** 2 / factor, LEAST_NOISE)
    alone = [[start] for start in STARTS]
    of_gain, log_gain = Walks.best(left, noise, lambda s: (s[0], 0.0), alone)
    added, log_added = Walks.best(left, noise, lambda s: (0.0, s[0]), alone)
    share, probability = max(of_gain.predicted, 0.0), 0.0
    if gain(of_gain.cells, added.cells, PRIOR).probability > ACCEPTED:
        beside = [[*log_gain, *(log_added + STARTS[0])], [*(log_gain + STARTS[0]), *log_added]]
        both, _ = Walks.best(left, noise, lambda s: (s[0], s[1]), beside)
        needs_gain, needs_added = (max(both.nats - one.nats, 0.0) for one in (added, of_gain))
        evidence = needs_gain / max(needs_gain + needs_added, 1e-300)
        probability = round(trust(share * evidence * of_no_motion(left)), 4)
    shown = Walks.of(
        [Left.of(r, e, r.train | r.held_out, span_um, factor) for r, e in each],
        noise,
        float(np.exp(log_gain[0])),
        0.0,
    )
    power, of_motion = (
        mean_square(np.concatenate(all_of)) for all_of in (shown.adds, [one.x for one in left])
    )
    effect = NamedEffect(
        GainModulation.name,
        GainModulation.block,
        GainModulation.degenerate_with,
        probability,
        (Parameter("gain_rms", sqrt(power / of_motion), "", None),),
        share,
        "y = x [1 + g], g a random walk",
        GainModulation.signature,
        (),
        "random walk",
    )
    adds = [
        span_um * np.interp(np.arange(len(r.y)), factor * (np.arange(len(one)) + 0.5) - 0.5, one)
        for r, one in zip(records, shown.adds, strict=True)
    ]
    return effect, adds


def of_no_motion(left: Sequence[Left]) -> float:
    """Return the share, 0–1, of a residual that the motion, with its past, predicts no better than by chance:
    as it predicts the residual reversed in time, since any slow signal resembles another."""
    each = []
    for k, one in enumerate(left):
        x, own = one.x - one.x.mean(), np.zeros((len(left), len(one.x)))
        own[k] = 1.0
        past = [x - np.concatenate([np.full(min(int(lag), len(x)), x[0]), x[:-lag]]) for lag in LAGS]
        each.append(
            np.stack([*own, x, x**2, x**3, *(f for p in past for f in (p, np.abs(p), p * x))], axis=1)
        )
    rows = np.concatenate(each)
    rows /= np.maximum(np.abs(rows).max(axis=0), 1e-300)
    signals = [np.concatenate([one.e[::order] for one in left]) for order in (1, -1)]
    rest, by_chance = (unpredicted(e, rows) for e in signals)
    return min(rest / max(by_chance, 1e-300), 1.0)


def unpredicted(e: np.ndarray, rows: np.ndarray) -> float:
    """Return the share of the mean square of a signal, (time,), that rows, (time, rows), do not predict."""
    counts = np.isfinite(e)
    rows, e = rows[counts], e[counts]
    rest = e - rows @ np.linalg.lstsq(rows, e, rcond=1e-8)[0]
    return float(rest @ rest) / max(float(e @ e), 1e-300)


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
