"""Maps of the residual over eight domains, made before any effect is named.

A map divides all samples (or all frequencies) into cells and gives each cell two numbers. Its *share* is the
part of the squared residual above the noise floor that the cell holds. Its *significance* says whether the
residual is larger there than elsewhere by more than chance. Chance is judged by the residual's own colour:
squares of correlated samples count as fewer independent numbers. Each recording is cut into blocks four
correlation times long; the scatter of the blocks' sums within a cell gives the number of independent squares
in the cell (Kish's design effect, with blocks as clusters; the cells' median, so that one burst does not hide
itself, and never more than one per sample). The ratio of two mean squares with these degrees of freedom is an
F ratio; its normal score (Paulson 1942) is the significance. White noise stays below `SIGNIFICANT` in all
maps together in 98 of 100 diagnoses; for noise with only about a hundred correlation times in the recordings,
one cell in 500 exceeds it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numba import njit

from torchpi.diagnosis.diagnosis import Domain, Trace, Where

INDEPENDENT = 2 / 3
"""Share of the frequencies of a Hann-windowed spectrum that are independent (its noise bandwidth is 1.5)."""

SIGNIFICANT = 4.0
"""Standard deviations above which a cell is worth reporting, as the maps have a hundred cells."""
LEAST_REVERSAL = 0.005
"""Share of the input's span: a smaller move back does not count as a reversal."""
LEAST_REST = 10
"""Minimum number of samples without motion of the input that count as a rest."""
TIME_CELLS, LEVEL_CELLS, SWING_CELLS = 12, 12, 8
BANDS_PER_DECADE = 6


def locate(traces: Sequence[Trace], noise_floor_um: float) -> tuple[Where, ...]:
    """Return maps of the retuned stage's residual over the eight domains.

    Time has a map in seconds for each recording, and one over relative time if there are several recordings.
    Rate has two maps: its magnitude, and its sign and magnitude. The other domains have one each. The shares
    of a map add up to 1, or are all 0 if nothing exceeds the floor. In frequency the floor is taken as white,
    and a band is compared with the recording's median density, which neither one peak nor a slow drift
    raises. A rest is ten samples or more without any change of the input, so a measured, noisy input has
    none.

    Args:
        traces: The recordings.
        noise_floor_um: Standard deviation of the noise, µm; 0 where it is not known.

    Returns:
        The cells that hold samples, map by map in the order of `Domain`, each map from low to high.
    """
    several = len(traces) > 1
    samples = _Samples.of(traces)
    maps = [_time(traces), *([_relative_time(traces)] if several else [])]
    found = [where for one in maps for where in samples.map(one, noise_floor_um)]
    found += _frequency(traces, noise_floor_um)
    drives = [_Drive.of(trace) for trace in traces]
    for one in (
        _displacement(traces),
        _size_of_rate(drives),
        _signed_rate(drives),
        _direction(drives),
        _since_reversal(drives),
        _amplitude(drives),
        _recording(traces),
    ):
        found += samples.map(one, noise_floor_um)
    return tuple(found)


def normal_score(ratio: float, above: float, below: float) -> float:
    """Return how many standard deviations an F ratio with `above` and `below` degrees of freedom is from 1.

    Paulson, Ann. Math. Statist. 13 (1942): the cube root of F is nearly normal.
    """
    a, b, root = 2 / (9 * above), 2 / (9 * below), np.cbrt(ratio)
    return float(((1 - b) * root - (1 - a)) / np.sqrt(b * root**2 + a))


@dataclass(frozen=True, eq=False)
class _Cells:
    """The cells of one map, and the cell of each sample."""

    domain: Domain
    unit: str
    ranges: Sequence[tuple[float, float]]
    index: np.ndarray  # shape: (samples of all recordings,)
    labels: Sequence[str]


@dataclass(frozen=True, eq=False)
class _Samples:
    """The squared residuals of all recordings, concatenated."""

    squares: np.ndarray  # shape: (samples,), µm²
    block: np.ndarray  # shape: (samples,), the block of each sample
    blocks: int

    @classmethod
    def of(cls, traces: Sequence[Trace]) -> "_Samples":
        block, blocks = [], 0
        for trace in traces:
            block.append(blocks + np.arange(len(trace.t)) // _block_length(trace.residual_retuned))
            blocks = int(block[-1][-1]) + 1
        squares = np.concatenate([trace.residual_retuned**2 for trace in traces])
        return cls(squares, np.concatenate(block), blocks)

    def map(self, cells: _Cells, noise_floor_um: float) -> list[Where]:
        count = len(cells.ranges)
        joint = self.block * count + cells.index
        n_of = np.bincount(joint, minlength=self.blocks * count).reshape(self.blocks, count)
        sum_of = np.bincount(joint, self.squares, self.blocks * count).reshape(self.blocks, count)
        n, total = n_of.sum(0), sum_of.sum(0)
        excess = np.maximum(total - n * noise_floor_um**2, 0.0)
        share = excess / excess.sum() if excess.sum() > 0 else np.zeros(count)
        each = 2 / _design_effect(n_of, sum_of)  # degrees of freedom per sample
        found = []
        for c in np.flatnonzero(n).tolist():
            others, rest = n.sum() - n[c], total.sum() - total[c]
            significance = 0.0
            if others and rest > 0:
                ratio = (total[c] / n[c]) / (rest / others)
                significance = normal_score(ratio, each * n[c], each * others)
            found.append(
                Where(
                    cells.domain,
                    cells.ranges[c],
                    cells.unit,
                    float(share[c]),
                    significance,
                    cells.labels[c],
                )
            )
        return found


def _block_length(e: np.ndarray) -> int:
    """Return four correlation times of the squares, at least 16 samples, at most a fortieth of the recording.

    The squares of Gaussian noise with autocorrelation ρ have the autocorrelation ρ². The sum over ρ² ends
    where ρ first falls below its own noise.
    """
    size = 1 << (2 * len(e) - 1).bit_length()
    power = np.abs(np.fft.rfft(e - e.mean(), size)) ** 2
    covariance = np.fft.irfft(power)[: len(e)]
    if covariance[0] <= 0:
        return 16
    rho = covariance / covariance[0]
    ends = np.flatnonzero(np.maximum(np.abs(rho[:-1]), np.abs(rho[1:])) < 2 / np.sqrt(len(e)))
    time = 1 + 2 * float((rho[1 : ends[0] if len(ends) else len(e)] ** 2).sum())
    return int(max(16, min(4 * time, len(e) // 40)))


def _design_effect(n_of: np.ndarray, sum_of: np.ndarray) -> float:
    """Return the variance of a cell's mean square, times its samples, over its square; 2 for white noise."""
    n, visits = n_of.sum(0), (n_of > 0).sum(0)
    mean = sum_of.sum(0) / np.maximum(n, 1)
    variance = ((sum_of - mean * n_of) ** 2).sum(0) / np.maximum(n, 1) * visits / np.maximum(visits - 1, 1)
    revisited = (visits >= 3) & (mean > 0)
    if not revisited.any():
        return 2.0
    effects = np.sort(variance[revisited] / mean[revisited] ** 2)
    kept = len(effects) - max(1, len(effects) // 10) if len(effects) > 1 else 1
    return max(2.0, float(effects[:kept].mean()))


def _time(traces: Sequence[Trace]) -> _Cells:
    ranges: list[tuple[float, float]] = []
    labels: list[str] = []
    index = []
    for trace in traces:
        cell = np.arange(len(trace.t)) * TIME_CELLS // len(trace.t)
        index.append(len(ranges) + cell)
        edges = trace.t[0] + np.arange(TIME_CELLS + 1) * (len(trace.t) / trace.fs_hz / TIME_CELLS)
        ranges += _pairs(edges)
        labels += [trace.name] * TIME_CELLS
    return _Cells("time", "s", ranges, np.concatenate(index), labels)


def _relative_time(traces: Sequence[Trace]) -> _Cells:
    index = np.concatenate([np.arange(len(trace.t)) * TIME_CELLS // len(trace.t) for trace in traces])
    ranges = _pairs(np.arange(TIME_CELLS + 1) / TIME_CELLS)
    return _Cells("time", "of the recording", ranges, index, ["all recordings"] * TIME_CELLS)


def _frequency(traces: Sequence[Trace], noise_floor_um: float) -> list[Where]:
    spectra = [_density(trace) for trace in traces]
    lowest = 4 / max(len(trace.t) / trace.fs_hz for trace in traces)
    highest = max(trace.fs_hz / 2 for trace in traces)
    count = max(1, round(BANDS_PER_DECADE * float(np.log10(highest / lowest))))
    edges = np.concatenate([[0.0], np.geomspace(lowest, highest, count + 1)])
    power, expected, floor = np.zeros(count + 1), np.zeros(count + 1), np.zeros(count + 1)
    above, below = np.zeros(count + 1), np.zeros(count + 1)
    for trace, (f, density) in zip(traces, spectra, strict=True):
        n, per_hz = len(trace.t), f[1]
        band = np.clip(np.searchsorted(edges, f, "right") - 1, 0, count)
        bins = np.bincount(band, minlength=count + 1)
        white = 2 * noise_floor_um**2 / trace.fs_hz
        reference = max(float(np.median(density)) / np.log(2), white)
        power += n * per_hz * np.bincount(band, density, count + 1)
        floor += n * per_hz * bins * white
        own = n * per_hz * bins * reference
        expected += own
        # Variances of the two: of a mean of exponentially distributed numbers, and of their median.
        above += own**2 / np.maximum(INDEPENDENT * bins, 1)
        below += own**2 / (INDEPENDENT * len(f) * np.log(2) ** 2)
    excess = np.maximum(power - floor, 0.0)
    share = excess / excess.sum() if excess.sum() > 0 else np.zeros(count + 1)
    return [
        Where(
            "frequency",
            (float(edges[c]), float(edges[c + 1])),
            "Hz",
            float(share[c]),
            normal_score(
                power[c] / expected[c], 2 * expected[c] ** 2 / above[c], 2 * expected[c] ** 2 / below[c]
            )
            if expected[c] > 0
            else 0.0,
        )
        for c in range(count + 1)
        if power[c] > 0 or expected[c] > 0
    ]


def _density(trace: Trace) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies and the one-sided power density of the residual, µm²/Hz, with a Hann window."""
    e = trace.residual_retuned
    window = np.hanning(len(e) + 2)[1:-1]
    density = 2 * np.abs(np.fft.rfft(e * window)) ** 2 / ((window**2).sum() * trace.fs_hz)
    return np.fft.rfftfreq(len(e), 1 / trace.fs_hz), density


def _displacement(traces: Sequence[Trace]) -> _Cells:
    y = np.concatenate([trace.y for trace in traces])
    return _cut("displacement", "µm", y, np.linspace(y.min(), y.max(), LEVEL_CELLS + 1))


@dataclass(frozen=True, eq=False)
class _Drive:
    """What the input does at each sample, (time,)."""

    rate: np.ndarray  # V/s, since the previous sample
    direction: np.ndarray  # 1, −1, 0 at rest
    since_s: np.ndarray  # since the last reversal of the input
    swing_v: np.ndarray  # from the previous reversal to the next

    @classmethod
    def of(cls, trace: Trace) -> "_Drive":
        u = np.ascontiguousarray(trace.u, dtype=np.float64)
        turns = turning_points(u, LEAST_REVERSAL * float(np.ptp(u)))
        part = np.searchsorted(turns, np.arange(len(u)), "right") - 1
        ends = np.append(turns, len(u) - 1)
        way = u[ends[1:]] - u[ends[:-1]]
        direction = np.sign(way)[part]
        direction[_rests(u)] = 0
        since_s = (np.arange(len(u)) - turns[part]) / trace.fs_hz
        return cls(np.diff(u, prepend=u[0]) * trace.fs_hz, direction, since_s, np.abs(way)[part])


@njit(cache=True)
def turning_points(u: np.ndarray, least: float) -> np.ndarray:
    """Return the indices where the input reverses by more than `least`; the first is the start, 0."""
    turns = [0]
    low = high = 0
    heading = 0
    for k in range(1, len(u)):
        if u[k] >= u[high]:
            high = k
        if u[k] <= u[low]:
            low = k
        if heading <= 0 and u[k] - u[low] > least:
            if heading < 0:
                turns.append(low)
            heading, high = 1, k
        elif heading >= 0 and u[high] - u[k] > least:
            if heading > 0:
                turns.append(high)
            heading, low = -1, k
    return np.array(turns)


def _rests(u: np.ndarray) -> np.ndarray:
    """Whether each sample lies within a long enough run of equal values, (time,), bool."""
    moved = np.concatenate([[0], np.flatnonzero(np.diff(u) != 0) + 1, [len(u)]])
    lengths = np.diff(moved)
    return np.repeat(lengths >= LEAST_REST, lengths)


def _size_of_rate(drives: Sequence[_Drive]) -> _Cells:
    rate = np.abs(np.concatenate([drive.rate for drive in drives]))
    cells = _cut("rate", "V/s", rate, _rate_edges(rate))
    return _Cells("rate", "V/s", cells.ranges, cells.index, ["either way"] * len(cells.ranges))


def _signed_rate(drives: Sequence[_Drive]) -> _Cells:
    rate = np.concatenate([drive.rate for drive in drives])
    edges = _rate_edges(np.abs(rate))[1:]
    cells = _cut("rate", "V/s", rate, np.concatenate([-edges[::-1], edges]))
    labels = ["falling" if high <= 0 else "rising" if low >= 0 else "slow" for low, high in cells.ranges]
    return _Cells("rate", "V/s", cells.ranges, cells.index, labels)


def _rate_edges(size: np.ndarray) -> np.ndarray:
    """Return the cell edges: 0, then about three cells per decade up to the largest rate."""
    moving = size[size > 0]
    if not len(moving):
        return np.array([0.0, 1.0])
    highest = float(moving.max())
    lowest = min(float(np.quantile(moving, 0.05)), highest / 10)
    count = int(np.clip(np.ceil(3 * np.log10(highest / lowest)), 3, 9))
    return np.concatenate([[0.0], np.geomspace(lowest, highest, count + 1)])


def _direction(drives: Sequence[_Drive]) -> _Cells:
    index = np.concatenate([drive.direction for drive in drives]).astype(int) + 1
    ranges = [(-1.0, -1.0), (0.0, 0.0), (1.0, 1.0)]
    return _Cells("direction", "sign of the rate", ranges, index, ["down", "rest", "up"])


def _since_reversal(drives: Sequence[_Drive]) -> _Cells:
    since_s = np.concatenate([drive.since_s for drive in drives])
    later = since_s[since_s > 0]
    if not len(later):
        return _cut("since_reversal", "s", since_s, np.array([0.0, 1.0]))
    longest = float(later.max())
    first = min(max(float(later.min()) * 3, longest * 1e-5), longest / 2)
    count = max(1, round(3 * float(np.log10(longest / first))))
    edges = np.concatenate([[0.0], np.geomspace(first, longest, count + 1)])
    return _cut("since_reversal", "s", since_s, edges)


def _amplitude(drives: Sequence[_Drive]) -> _Cells:
    swing = np.concatenate([drive.swing_v for drive in drives])
    most = float(swing.max())
    return _cut("amplitude", "V", swing, np.linspace(0.0, most if most > 0 else 1.0, SWING_CELLS + 1))


def _recording(traces: Sequence[Trace]) -> _Cells:
    index = np.repeat(np.arange(len(traces)), [len(trace.t) for trace in traces])
    ranges = [(float(i), float(i)) for i in range(1, len(traces) + 1)]
    return _Cells("recording", "number", ranges, index, [trace.name for trace in traces])


def _cut(domain: Domain, unit: str, values: np.ndarray, edges: np.ndarray) -> _Cells:
    count = len(edges) - 1
    index = np.clip(np.searchsorted(edges, values, "right") - 1, 0, count - 1)
    return _Cells(domain, unit, _pairs(edges), index, [""] * count)


def _pairs(edges: np.ndarray) -> list[tuple[float, float]]:
    return [(float(low), float(high)) for low, high in pairwise(edges)]
