"""One score: how well a hypothesis predicts Haar coefficients that it was not fitted to.

Each stretch of time is predicted on all scales at once by the fit to the others (cross-validation in one step
of the full fit, exact where the model is linear: Stone, *J. Royal Statistical Society* B 36(2), 1974; in
blocks, because the data depend on the past: Burman, Chow and Nolan, *Biometrika* 81(2), 1994). If single
coefficients were left out, their neighbours would determine them, and a hysteresis with many weights would
seem to predict well. The coefficients of one cell, a stretch of time on one scale, share an unknown variance,
whose prior is the noise known there with `KNOWN` degrees of freedom. With the variance integrated out, the
log density of a cell is that of a multivariate Student t,

    ℓ_c = -½ (ν + n_c) ln(1 + n_c q_c / ν),    q_c = mean square over that of the noise.

A cell counts as at most `AT_MOST` coefficients: model errors are correlated, and a wide quiet band must not
outvote everything slow. The difference of two hypotheses is a sum over cells, with a standard error from
their scatter (Vehtari, Gelman and Gabry, *Statistics and Computing* 27, 2017).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256

import numpy as np
from scipy.special import ndtr

from torchpi.diagnosis.hypothesis import Fit
from torchpi.diagnosis.noise import Noise, held_error, is_white
from torchpi.diagnosis.records import Record
from torchpi.diagnosis.repeats import APART, KINDS, PLAIN, STARTING

KNOWN = 4.0
"""Degrees of freedom of the prior on the noise of a cell: it is known to a factor of about two."""
AT_MOST = 30.0
"""Largest number of coefficients that one cell counts for."""
ALIKE = 2.0
"""Ratio of the standard error to that of independent cells: a model's errors recur in every cycle and on
neighbouring scales. Calibrated: `concealed/judging/calibration.py`."""
LEAST_IN_STRATUM = 4
"""Smallest number of cells from whose differences a standard error is estimated."""
TINY = 1e-12


@dataclass(frozen=True, eq=False)
class Weighting:
    """Expected size of each coefficient's residual, given the best fit so far."""

    inverse_sd: tuple[np.ndarray, ...]  # shape: (kept,) for each recording, 1/µm
    level_um2: np.ndarray  # shape: (cells of all recordings,), the noise's mean square in each cell
    counts: np.ndarray  # shape: (cells,), number of coefficients in each
    floor_um2: np.ndarray  # shape: (cells,), mean square that nothing explains: the noise, if measured
    strata: np.ndarray  # shape: (cells,), cells of one stratum have a recording, a kind and a scale in common
    kinds: np.ndarray  # shape: (cells,), whether of the readings, or of their part that does not repeat

    @classmethod
    def of(
        cls, records: Sequence[Record], residuals: Sequence[np.ndarray], noise: Noise | None
    ) -> "Weighting":
        """Return the weighting for residuals of the best fit, (time,) each, µm, and the measured noise."""
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
            # A typical residual is no noise floor: model errors found everywhere would count as explained.
            # Where nothing was measured and the residual is not white, its smallest part is none either.
            finest_um2 = noise_um2[own == own.min()].min()
            if noise is None and not is_white(residual[record.train]):
                finest_um2 = 0.0
            floors.append(noise_um2 if measured else np.minimum(noise_um2, finest_um2))
            # Dynamics that the model lacks may ring in the start transient as loudly as they recur later.
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
        """Return equal weights for all coefficients, for use before anything is known."""
        sd = 1e-3 * max(float(np.ptp(record.y)) for record in records) or 1e-9
        counts = np.concatenate([np.bincount(record.coefficients.cell) for record in records]).astype(float)
        scales = tuple(np.full(record.coefficients.kept, 1 / sd) for record in records)
        level_um2 = np.full(len(counts), sd**2)
        return cls(scales, level_um2, counts, level_um2, strata_of(records), kinds_of(records))

    @cached_property
    def token(self) -> str:
        """Key that distinguishes this weighting from others."""
        return sha256(np.concatenate(self.inverse_sd).tobytes()).hexdigest()

    @property
    def geometric_mean_rms_um(self) -> float:
        """Median of the expected residual of a coefficient."""
        return float(1 / np.median(np.concatenate(self.inverse_sd)))

    @property
    def mean_floor_um2(self) -> float:
        """Mean square of a reading that nothing explains."""
        return float(self.floor_um2 @ self.counts / self.counts.sum())

    def log_density(self, fit: Fit) -> np.ndarray:
        """(cells,): ℓ_c of a fit."""
        return self.of_squares(fit.left_out_um2)

    def explained_where_it_acts(self, more: Fit, less: Fit) -> float:
        """Return the share, 0–1, that a fit explains beyond another of all that is to be explained in the
        cells where it gains; each cell is weighted by the nats gained there."""
        gained = np.maximum(less.left_out_um2 - more.left_out_um2, 0.0)
        left = np.maximum(more.left_out_um2 - self.floor_um2, 0.0)
        share = gained / np.maximum(gained + left, 1e-300)
        nats = np.maximum(self.log_density(more) - self.log_density(less), 0.0)
        return float((nats * share).sum() / max(float(nats.sum()), 1e-300))

    def explained_of_all(self, more: Fit, less: Fit) -> float:
        """Return the share, 0–1, that a fit explains beyond another, of that and all that it leaves: averaged
        over the readings and their part that does not repeat, weighted by the nats gained in each."""
        gained = np.maximum(less.left_out_um2 - more.left_out_um2, 0.0) * self.counts
        # Noise exceeds its mean in half of the cells, so the excess is summed over a scale before clipping.
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
        """(kinds,): nats that a fit gains over another in those cells of each kind where it gains; for the
        readings, only what exceeds the gain in their part that does not repeat."""
        nats = np.maximum(self.log_density(more) - self.log_density(less), 0.0)
        found: np.ndarray = np.bincount(self.kinds, nats, len(KINDS))
        found[PLAIN] = max(found[PLAIN] - found[[STARTING, APART]].sum(), 0.0)
        return found

    def of_squares(self, mean_um2: np.ndarray) -> np.ndarray:
        """(cells,): ℓ_c for given mean squares of the cells, (cells,), µm²."""
        n = np.minimum(self.counts, AT_MOST)
        ratio = np.minimum(mean_um2 / self.level_um2, 1e30)
        density: np.ndarray = -0.5 * (KNOWN + n) * np.log1p(n / KNOWN * ratio)
        return density


@dataclass(frozen=True)
class Gain:
    """Difference in log predictive density between two hypotheses, with its standard error."""

    nats: float
    sd: float

    @property
    def probability(self) -> float:
        """Probability that the first hypothesis predicts better."""
        return float(ndtr(self.nats / self.sd)) if self.sd > 0 else float(self.nats > 0)


def gain(better: np.ndarray, worse: np.ndarray, prior: float = 0.0, strata: np.ndarray | None = None) -> Gain:
    """Return how much better one hypothesis predicts, with the standard error of a stratified sum.

    Every effect acts on its own scales, so differences between scales are not random; differences between the
    cells of one scale are (Cochran, *Sampling Techniques*, 1977, 5.3).

    Args:
        better: (cells,), log densities.
        worse: The same for the other hypothesis.
        prior: The log of the prior odds.
        strata: (cells,), the stratum of each cell; None where all are in one.
    """
    d = better - worse
    strata = np.zeros(len(d), dtype=int) if strata is None else strata
    size = np.bincount(strata)
    mean = np.bincount(strata, d) / size
    size = np.maximum(size, 2)
    variance = np.sum((d - mean[strata]) ** 2 * (size / (size - 1))[strata])
    return Gain(float(d.sum()) + prior, max(ALIKE * float(np.sqrt(variance)), 1.0))


def strata_of(records: Sequence[Record]) -> np.ndarray:
    """(cells,): the stratum of each cell, by recording, kind and scale; a scale of fewer than
    `LEAST_IN_STRATUM` cells is merged with the next finer one."""
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
    """(cells,): the kind of the piece in which each cell lies."""
    return np.concatenate([record.coefficients.kind_of_cell for record in records])
