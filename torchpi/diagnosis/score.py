"""One score: how well a hypothesis predicts Haar coefficients that it was not fitted to.

Each stretch of time is predicted by the fit to the others, all scales of it at once (cross-validation in one
step of the full fit, exact where the model is linear: Stone, *J. Royal Statistical Society* B 36(2), 1974;
blocks for what depends on the past: Burman, Chow and Nolan, *Biometrika* 81(2), 1994). Single coefficients
left out would be told by their neighbours, and a hysteresis of many numbers would pass for one that predicts.
The coefficients of one cell, a stretch of time on one scale, share a variance that is unknown but for what is
known of the noise there, with `KNOWN` degrees of freedom: integrated out, the log density of a cell is that
of a multivariate Student t,

    ℓ_c = -½ (ν + n_c) ln(1 + n_c q_c / ν),    q_c = mean square over the noise's.

A cell counts as `AT_MOST` coefficients at most: what a model has wrong is correlated, and a wide quiet band
is not to outvote everything slow. The difference of two hypotheses is a sum over cells, with a standard error
from their scatter (Vehtari, Gelman and Gabry, *Statistics and Computing* 27, 2017).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256

import numpy as np
from scipy.special import ndtr

from torchpi.diagnosis.hypothesis import Fit
from torchpi.diagnosis.noise import Noise, held_error
from torchpi.diagnosis.records import Record
from torchpi.diagnosis.repeats import APART, KINDS, PLAIN, STARTING

KNOWN = 4.0
"""Degrees of freedom with which the noise of a cell is known beforehand: to a factor of about two."""
AT_MOST = 30.0
"""Coefficients that a cell counts for."""
ALIKE = 2.0
"""By what the standard error is larger than that of independent cells: what a model has wrong comes again in
every cycle and on neighbouring scales. Calibrated: `concealed/judging/calibration.py`."""
MORE = 1.04
"""Times the noise's mean square that is more than noise: nothing is named that adds less than a fifth of its
rms."""
LEAST_IN_STRATUM = 4
"""Cells whose differences tell a standard error."""
TINY = 1e-12


@dataclass(frozen=True, eq=False)
class Weighting:
    """What a coefficient may be off by, given the best fit so far."""

    inverse_sd: tuple[np.ndarray, ...]  # shape: (kept,) for each recording, 1/µm
    level_um2: np.ndarray  # shape: (cells of all recordings,), the noise's mean square in each cell
    counts: np.ndarray  # shape: (cells,), coefficients in each
    floor_um2: np.ndarray  # shape: (cells,), what nothing explains of each: the noise, if it was measured
    strata: np.ndarray  # shape: (cells,), cells of one stratum have a recording, a kind and a scale in common
    kinds: np.ndarray  # shape: (cells,), the readings, or what does not repeat of them

    @classmethod
    def of(
        cls, records: Sequence[Record], residuals: Sequence[np.ndarray], noise: Noise | None
    ) -> "Weighting":
        """From the residuals of the best fit, (time,) each, µm, and the noise that was measured."""
        scales, levels, floors, counts = [], [], [], []
        smallest = TINY * max(float(np.ptp(record.y)) for record in records) ** 2 + 1e-300
        for record, residual in zip(records, residuals, strict=True):
            of = record.coefficients
            e = of(residual[None])[0]
            n = np.bincount(of.cell)
            mean = np.bincount(of.cell, e**2) / n
            own, kind = of.level_of_cell, of.kind_of_cell
            measured = noise is not None and record.fs_hz == noise.fs_hz
            noise_um2 = np.empty(len(n))
            for level, one in sorted(set(zip(own.tolist(), kind.tolist(), strict=True))):
                there = (own == level) & (kind == one)
                if noise and measured:
                    noise_um2[there] = noise.level_um2(level)
                else:
                    noise_um2[there] = np.median(mean[there])
            if noise is not None and noise.lsb_um > 0:
                noise_um2 += noise.lsb_um**2 / 12 * (held_error(record.y, of) - 1)
            if noise is not None and measured and noise.monitor_um_per_v > 0:
                left_um = noise.monitor_um_per_v * record.monitor_noise_left_v[of.at]
                noise_um2 += np.bincount(of.cell, left_um**2) / n
            noise_um2 = np.maximum(noise_um2, smallest)
            # A typical residual is no noise: what a model has wrong everywhere would count as explained.
            finest_um2 = noise_um2[own == own.min()].min()
            floors.append(noise_um2 if measured else np.minimum(noise_um2, finest_um2))
            # What a model lacks of a stage's dynamics may ring while the stage starts: as loud as it repeats.
            for level in np.unique(own[kind == STARTING]):
                there = (own == level) & (kind == STARTING)
                mean[there] = np.maximum(mean[there], mean[(own == level) & (kind == PLAIN)].mean())
            variance = (KNOWN * noise_um2 + n * mean) / (KNOWN + n)
            scales.append(1 / np.sqrt(variance)[of.cell])
            levels.append(noise_um2)
            counts.append(n)
        counted = np.concatenate(counts).astype(float)
        return cls(
            tuple(scales),
            np.concatenate(levels),
            counted,
            np.concatenate(floors),
            strata_of(records),
            kinds_of(records),
        )

    @classmethod
    def flat(cls, records: Sequence[Record]) -> "Weighting":
        """Every coefficient alike, before anything is known."""
        sd = 1e-3 * max(float(np.ptp(record.y)) for record in records) or 1e-9
        counts = np.concatenate([np.bincount(record.coefficients.cell) for record in records]).astype(float)
        scales = tuple(np.full(record.coefficients.kept, 1 / sd) for record in records)
        level_um2 = np.full(len(counts), sd**2)
        return cls(scales, level_um2, counts, level_um2, strata_of(records), kinds_of(records))

    @cached_property
    def token(self) -> str:
        """What tells it from another."""
        return sha256(np.concatenate(self.inverse_sd).tobytes()).hexdigest()

    @property
    def geometric_mean_rms_um(self) -> float:
        """The median of what a coefficient may be off by."""
        return float(1 / np.median(np.concatenate(self.inverse_sd)))

    @property
    def mean_floor_um2(self) -> float:
        """The mean square that nothing explains of a reading."""
        return float(self.floor_um2 @ self.counts / self.counts.sum())

    def log_density(self, fit: Fit) -> np.ndarray:
        """(cells,): ℓ_c of a fit."""
        return self.of_squares(fit.left_out_um2)

    def explained_where_it_acts(self, more: Fit, less: Fit) -> float:
        """What a fit explains beyond another, 0–1, of all that is to be explained in the cells where it
        does; each cell counts by the nats that it gains."""
        gained = np.maximum(less.left_out_um2 - more.left_out_um2, 0.0)
        left = np.maximum(more.left_out_um2 - self.floor_um2, 0.0)
        share = gained / np.maximum(gained + left, 1e-300)
        nats = np.maximum(self.log_density(more) - self.log_density(less), 0.0)
        return float((nats * share).sum() / max(float(nats.sum()), 1e-300))

    def explained_of_all(self, more: Fit, less: Fit) -> float:
        """What a fit explains beyond another, 0–1, of that and of all that is left of the mean squares: of
        the readings, and of what does not repeat of them, as the nats are shared between them."""
        gained = np.maximum(less.left_out_um2 - more.left_out_um2, 0.0) * self.counts
        # Noise lies above its mean in half of the cells: all of a scale together tell what is left there.
        above = (more.left_out_um2 - self.floor_um2) * self.counts
        kind_of_stratum = np.zeros(int(self.strata.max()) + 1, dtype=int)
        kind_of_stratum[self.strata] = self.kinds
        left = np.maximum(np.bincount(self.strata, above), 0.0)
        left = np.bincount(kind_of_stratum, left, len(KINDS))
        explained = np.bincount(self.kinds, gained, len(KINDS))
        share = explained / np.maximum(explained + left, 1e-300)
        nats = self.nats_of_kinds(more, less)
        return float(share @ nats / max(float(nats.sum()), 1e-300))

    def nats_of_kinds(self, more: Fit, less: Fit) -> np.ndarray:
        """(kinds,): what a fit gains beyond another in the cells of each kind where it does; of the readings,
        beyond what it gains in what does not repeat of them."""
        nats = np.maximum(self.log_density(more) - self.log_density(less), 0.0)
        found: np.ndarray = np.bincount(self.kinds, nats, len(KINDS))
        found[PLAIN] = max(found[PLAIN] - found[[STARTING, APART]].sum(), 0.0)
        return found

    def above_noise_apart(self, fit: Fit) -> bool:
        """Whether what does not repeat with the voltage is more than noise, once the start is over."""
        apart = self.kinds == APART
        left = fit.left_out_um2[apart] @ self.counts[apart]
        return bool(left > MORE * (self.floor_um2[apart] @ self.counts[apart]))

    def of_squares(self, mean_um2: np.ndarray) -> np.ndarray:
        """The same of the cells' mean squares, (cells,), µm²."""
        n = np.minimum(self.counts, AT_MOST)
        ratio = np.minimum(mean_um2 / self.level_um2, 1e30)
        density: np.ndarray = -0.5 * (KNOWN + n) * np.log1p(n / KNOWN * ratio)
        return density


@dataclass(frozen=True)
class Gain:
    """By how much one hypothesis predicts better than another."""

    nats: float
    sd: float

    @property
    def probability(self) -> float:
        """That it does."""
        return float(ndtr(self.nats / self.sd)) if self.sd > 0 else float(self.nats > 0)


def gain(better: np.ndarray, worse: np.ndarray, prior: float = 0.0, strata: np.ndarray | None = None) -> Gain:
    """How much better one hypothesis predicts, with the standard error of a stratified sum.

    Every effect acts on scales of its own: that scales differ is no chance, that the cells of one scale
    differ is (Cochran, *Sampling Techniques*, 1977, 5.3).

    Args:
        better: (cells,), log densities.
        worse: The same of the other.
        prior: The log of the prior odds.
        strata: (cells,), in which stratum each lies; None where all are in one.
    """
    d = better - worse
    strata = np.zeros(len(d), dtype=int) if strata is None else strata
    size = np.bincount(strata)
    mean = np.bincount(strata, d) / size
    size = np.maximum(size, 2)
    variance = np.sum((d - mean[strata]) ** 2 * (size / (size - 1))[strata])
    return Gain(float(d.sum()) + prior, max(ALIKE * float(np.sqrt(variance)), 1.0))


def strata_of(records: Sequence[Record]) -> np.ndarray:
    """(cells,): the cells of each recording by their kind and scale, scales of fewer than `LEAST_IN_STRATUM`
    cells with the next finer one."""
    found, first = [], 0
    for record in records:
        level, kind = record.coefficients.level_of_cell, record.coefficients.kind_of_cell
        stratum = np.zeros(len(level), dtype=int)
        for each in np.unique(kind):
            count = 0
            for one in sorted(np.unique(level[kind == each]), reverse=True):
                there = (level == one) & (kind == each)
                stratum[there] = first
                count += int(there.sum())
                if count >= LEAST_IN_STRATUM:
                    first, count = first + 1, 0
            first += count > 0
        found.append(stratum)
    return np.concatenate(found)


def kinds_of(records: Sequence[Record]) -> np.ndarray:
    """(cells,): the kind of the piece that each lies in."""
    return np.concatenate([record.coefficients.kind_of_cell for record in records])
