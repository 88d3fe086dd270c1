"""A gain or a zero that wanders: whether what a fit leaves is a slow signal of its own.

What changes at no fixed frequency has too many numbers to be fitted beside other effects, and a signal that
may take any shape would absorb whatever is slow. It is therefore read off the final residual, by comparing
random walks (`torchpi.diagnosis.walks`): a gain needs no added signal beside it, and no added signal can take
its place, nor the other way round.

Where the voltage repeats, that part of the residual is taken first which does not: no function of the voltage
remains in it. Elsewhere a misfit of the hysteresis wanders as a zero does, so only a gain is looked for.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from scipy.ndimage import uniform_filter1d

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
from torchpi.diagnosis.walks import CELLS, Comparison, Left, Walks
from torchpi.recordings.faults import robust_sd
from torchpi.stage.effects.effect import Described, Effect
from torchpi.stage.effects.sensor.gain_modulation import FEWEST_PERIODS, GainModulation
from torchpi.stage.effects.sensor.thermal_drift import ThermalDrift

AT_MOST = 3000
"""Number of means of each recording from which a filter starts to cost more than it shows."""
SLOW = 20 * CELLS
"""The same for what does not repeat with the voltage, where any slow signal would be a wandering zero."""
REPEATS = 0.25
"""Share of a recording's means that have to come again, or too little of a walk is seen: a third of a period,
repeated."""
LEAST_NOISE = 1e-16
"""Variance of the noise below which none is assumed, over that of the travel."""
LAGS = 2 ** np.arange(6)
"""Samples back from which the motion may predict a residual."""
EARLY = 0.01
"""Share of a recording before its first sample, at which its age is taken to begin."""
JUMPS = 0.15
"""Share of a walk's squared increments in their largest hundredth, from which it jumps rather than wanders:
twice that of normal increments."""
CYCLES = np.arange(FEWEST_PERIODS, SLOW / 8, 0.25)
"""Periods in a recording of the lines that a wandering zero may be."""
LINE = 0.6
"""Share of what a zero adds from which one line may cause it: a random walk has it once in twenty-five."""
FOLLOWS = 0.5
"""Share of what does not repeat from which other recorded signals cause it, by whatever law."""
WANDERS: tuple[type[Effect], ...] = (ThermalDrift, GainModulation)


@dataclass(frozen=True, eq=False)
class Wandering:
    """A gain or a zero that wanders."""

    effect: type[Effect]
    alternatives: tuple[str, ...]
    """What these recordings cannot distinguish from it."""
    probability: float
    share: float
    """Share of the residual's mean square that it explains, 0–1."""
    rms: float
    """Of a gain, as a ratio; of a zero, µm."""
    adds: list[np.ndarray]
    """(time,), µm, for each recording."""

    @property
    def named(self) -> NamedEffect:
        of_gain = self.effect is GainModulation
        return NamedEffect(
            self.effect.name,
            self.effect.block,
            self.alternatives,
            self.probability,
            (Parameter("gain_rms" if of_gain else "drift_rms_um", self.rms, "" if of_gain else "µm", None),),
            self.share,
            "y = x [1 + g], g a random walk" if of_gain else "y = x + a, a a random walk",
            self.effect.signature,
            (),
            "random walk",
        )


def with_wandering(
    decision: Decision,
    records: Sequence[Record],
    retuned: Fit,
    final: Fit,
    noise: Noise | None,
    tried: Collection[type[Described]] = WANDERS,
) -> tuple[Decision, Wandering | None]:
    """Name that one of these effects which the residual shows to wander, if it is not named already. No stage
    can predict it from the voltage, so it explains its share, but the verdict is not "explained"."""
    there = {one.name for one in decision.effects}
    wanted = [effect for effect in WANDERS if effect in tried and effect.name not in there]
    found = wandering(records, final, noise.rms_um if noise is not None else 0.0) if wanted else None
    if found is None or found.effect not in wanted or there & {*found.alternatives}:
        return decision, None
    # Where the noise was not measured, nothing of what is left counts as unexplained yet.
    measured = noise is not None
    left = decision.unexplained_share if measured else (final.train_rms / retuned.train_rms) ** 2
    share = left * found.share
    others = [replace(one, share=one.share * (1.0 if measured else 1.0 - share)) for one in decision.effects]
    effects = sorted([*others, replace(found.named, share=share)], key=lambda one: -one.share)
    named = replace(
        decision,
        verdict="partly_explained",
        effects=tuple(effects),
        open=tuple(one for one in decision.open if one.name != found.effect.name),
        unexplained_share=decision.unexplained_share * (1.0 - found.share),
    )
    return named, found


def wandering(records: Sequence[Record], final: Fit, noise_um: float) -> Wandering | None:
    """Return what wanders, if it can be named.

    Args:
        records: The recordings.
        final: The fit whose residuals are examined.
        noise_um: The noise of a reading, 0 if it was not measured.
    """
    for of in (of_what_does_not_repeat, of_the_whole):
        found = of(records, final.residuals, noise_um)
        if found is not None and found.probability >= NAMED:
            return found
    return None


def of_what_does_not_repeat(
    records: Sequence[Record], residuals: Sequence[np.ndarray], noise_um: float
) -> Wandering | None:
    """Return the gain or the zero that wanders in what does not repeat with the voltage, if it exceeds the
    noise. The other is an alternative where that may take its place; so is a modulation where a zero seems to
    have one frequency. A zero that jumps does not wander, nor does what follows another recorded signal."""
    scale = Scale.of(records, noise_um, SLOW)
    parts = [scale.apart(record, e) for record, e in zip(records, residuals, strict=True)]
    left = [
        one
        for record, (apart, again, rows) in zip(records, parts, strict=True)
        if np.isfinite((one := scale.left(record, apart, again, rows)).e).mean() > REPEATS
    ]
    if not left or follow_another(records, [apart for apart, *_ in parts]):
        return None
    found = Comparison.of(left, scale.noise)
    of_gain = found.of_gain.nats > found.added.nats
    walk, other = (found.of_gain, found.added) if of_gain else (found.added, found.of_gain)
    told_apart = better(walk, other)
    if jumps(found.added) and not (of_gain and told_apart):
        return None
    shown = [
        scale.left(r, apart, all_of(r), rows) for r, (apart, _, rows) in zip(records, parts, strict=True)
    ]
    adds = scale.adds(records, Walks.of(shown, scale.noise, walk.gain_step, walk.added_step))
    beside = [apart - added for (apart, *_), added in zip(parts, adds, strict=True)]
    added, rest, whole = (
        np.concatenate([signal[r.train] for signal, r in zip(signals, records, strict=True)])
        for signals in (adds, beside, residuals)
    )
    there = (added != 0.0) | (rest != 0.0)
    if robust_sd(added[there]) < robust_sd(rest[there]):
        return None
    effects = (GainModulation, ThermalDrift) if of_gain else (ThermalDrift, GainModulation)
    or_other = not told_apart or (not of_gain and like_a_line(records, adds))
    return Wandering(
        effects[0],
        (effects[1].name,) if or_other else (),
        round(trust(walk.predicted), 4),
        min(mean_square(added) / max(mean_square(whole), 1e-300), 1.0),
        scale.rms(adds, left if of_gain else []),
        adds,
    )


def of_the_whole(
    records: Sequence[Record], residuals: Sequence[np.ndarray], noise_um: float
) -> Wandering | None:
    """Return the gain that wanders in the residuals as they are, if it predicts better than a zero. Its share
    of the residual, that of the evidence for either walk, and the share of the residual that the motion does
    not predict have to be large together: a misfit of any kind has some of each."""
    scale = Scale.of(records, noise_um, AT_MOST)
    each = [(r, e, following(scale.displacement(r, e))) for r, e in zip(records, residuals, strict=True)]
    left = [scale.left(record, e, record.train, rows) for record, e, rows in each]
    found = Comparison.of(left, scale.noise)
    walk = found.of_gain
    if not better(walk, found.added):
        return None
    whole = [scale.left(record, e, all_of(record), rows) for record, e, rows in each]
    adds = scale.adds(records, Walks.of(whole, scale.noise, walk.gain_step, 0.0))
    return Wandering(
        GainModulation,
        (),
        round(trust(walk.predicted * found.evidence_of_gain() * of_no_motion(left)), 4),
        walk.predicted,
        scale.rms(adds, left),
        adds,
    )


@dataclass(frozen=True)
class Scale:
    """Units and means in which residuals are examined."""

    span_um: float
    """The travel: the unit of a residual."""
    factor: int
    """Number of samples of a mean."""
    noise: float
    """Least variance of a mean's noise."""

    @classmethod
    def of(cls, records: Sequence[Record], noise_um: float, at_most: int) -> "Scale":
        span_um = max(float(np.ptp(record.y)) for record in records)
        factor = max(1, max(len(record.y) for record in records) // at_most)
        return cls(span_um, factor, max((noise_um / span_um) ** 2 / factor, LEAST_NOISE))

    def displacement(self, record: Record, e: np.ndarray) -> np.ndarray:
        """Return the displacement that leaves this residual, (means,)."""
        return means(record.y - e, self.factor) / self.span_um

    def apart(self, record: Record, e: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the part of a residual, (time,), µm, that does not repeat; where it comes again, (time,) of
        bool, but for the first mean of a period, as it is a new one from there; and the same part of a zero
        and of a gain that change with time or its logarithm, as rows, (means, 2 + constants)."""
        repeats, share = record.coefficients.repeats, (np.arange(len(e)) + 0.5) / len(e)
        ages = np.stack([share, np.log(share + EARLY)])
        x = (record.y - e) / self.span_um
        apart, *constants = repeats.less_mean(np.concatenate([e[None], ages, x * ages]), record.train)
        again = np.pad(repeats.apart, (0, len(e) - len(repeats.apart)))
        for one in repeats.periodic:
            for start in range(one.start, one.end, one.period):
                again[start : start + self.factor] = False
        x = means(x, self.factor)
        rows = [x, np.ones_like(x), np.ones_like(x), *(means(row, self.factor) for row in constants)]
        return apart, again, np.stack(rows, axis=1)

    def left(self, record: Record, e: np.ndarray, counts: np.ndarray, rows: np.ndarray) -> Left:
        """Return a residual, (time,), µm, where it counts, beside these rows, (means, 2 + constants)."""
        return Left.of(e / self.span_um, counts, rows, self.factor, record.period_s)

    def adds(self, records: Sequence[Record], walks: Walks) -> list[np.ndarray]:
        """Return what walks add to each recording, (time,), µm."""
        return [
            self.span_um
            * np.interp(np.arange(len(r.y)), self.factor * (np.arange(len(one)) + 0.5) - 0.5, one)
            for r, one in zip(records, walks.adds, strict=True)
        ]

    def rms(self, adds: Sequence[np.ndarray], of_gain: Sequence[Left]) -> float:
        """Return the rms of what is added, in µm, or over that of the displacement if a gain adds it."""
        added_um, x = sqrt(mean_square(np.concatenate(adds))), [one.x for one in of_gain]
        return added_um / (self.span_um * sqrt(mean_square(np.concatenate(x)))) if x else added_um


def all_of(record: Record) -> np.ndarray:
    """Return where the readings of a record count, sealed or not, (time,) of bool."""
    counts: np.ndarray = record.train | record.held_out
    return counts


def better(walks: Walks, less: Walks) -> bool:
    """Whether walks predict better than others over the stretches of the recordings."""
    return gain(walks.cells, less.cells, PRIOR).probability > ACCEPTED


def jumps(walks: Walks) -> bool:
    """Whether few increments make up most of what is added, but for those after a gap."""
    steps = [
        np.diff(one[1:])[(one[2:] != 0.0) & (one[1:-1] != 0.0) & (one[:-2] != 0.0)] for one in walks.adds
    ]
    squares = np.sort(np.concatenate(steps) ** 2)
    largest = squares[-max(len(squares) // 100, 1) :]
    return float(largest.sum()) > JUMPS * float(squares.sum())


def like_a_line(records: Sequence[Record], adds: Sequence[np.ndarray]) -> bool:
    """Whether one line in each recording explains most of what a zero adds there, (time,), as far as neither
    repeats with the voltage."""
    left = 0.0
    for record, added in zip(records, adds, strict=True):
        along, rests = 2j * np.pi * np.arange(len(added)) / len(added), []
        for wave in (np.exp(cycles * along) for cycles in CYCLES):
            rows = record.coefficients.repeats.less_mean(np.stack([wave.real, wave.imag]), record.train)
            rest = added - np.linalg.lstsq(rows.T, added, rcond=None)[0] @ rows
            rests.append(float(rest @ rest))
        left += min(rests)
    return left < (1.0 - LINE) * sum(float(added @ added) for added in adds)


def follow_another(records: Sequence[Record], parts: Sequence[np.ndarray]) -> bool:
    """Whether other recorded signals, with their squares and their products with the displacement, predict
    most of those parts of the residuals, (time,) each, µm, that do not repeat with the voltage."""
    if not records[0].aux:
        return False
    left = whole = 0.0
    for record, part in zip(records, parts, strict=True):
        signals = np.array([*record.aux.values()])
        others = np.concatenate([signals, signals**2])
        rows = np.concatenate([others, (record.y - record.y.mean()) * others])
        rows = record.coefficients.repeats.less_mean(rows, record.train) * (part != 0.0)
        rest = part - np.linalg.lstsq(rows.T, part, rcond=None)[0] @ rows
        left, whole = left + float(rest @ rest), whole + float(part @ part)
    return left < (1.0 - FOLLOWS) * whole


def following(x: np.ndarray) -> np.ndarray:
    """Return rows, (means, 2 + constants), of gains that follow the displacement, (means,), its amplitude,
    speed, or age."""
    from_middle, about = x - x.mean(), max(len(x) // (2 * CELLS), 5)
    level = uniform_filter1d(from_middle, about)
    amplitude, speed = (
        np.sqrt(np.maximum(uniform_filter1d(square, about), 0.0))
        for square in ((from_middle - level) ** 2, np.gradient(x) ** 2)
    )
    speed /= max(float(speed.max()), 1e-300)
    along = np.linspace(-1.0, 1.0, len(x))
    of_gain = (np.ones_like(x), from_middle, amplitude, level, speed, along)
    return np.stack([x, np.ones_like(x), np.ones_like(x), *(from_middle * one for one in of_gain)], axis=1)


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
