"""Results of a run of the control loop: motions, errors and times, as named fields."""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

Signal = npt.NDArray[np.float64]  # shape: (time,)


@dataclass(frozen=True)
class Error:
    """Size of a tracking error, also relative to the trajectory's peak to peak and to the stage's range."""

    max_um: float
    rms_um: float
    max_percent: float  # of the trajectory's peak to peak
    rms_percent: float
    max_percent_of_range: float  # of the stage's range
    rms_percent_of_range: float


@dataclass(frozen=True)
class Tracking:
    """Tracking error before and after the stage has forgotten its initial state, and over the whole record.

    Loading ends where y_d first comes within 0.1 % (of peak to peak) of its global maximum: from there on,
    by the wiping-out property, the hysteresis no longer depends on how the record began.
    """

    loading: Error
    steady: Error
    whole: Error


@dataclass(frozen=True)
class Latency:
    """Wall-clock time of the compensator's `step`, called from Python, clock reading included."""

    steps: int
    median_us: float
    p99_us: float
    p999_us: float
    max_us: float
    period_us: float
    missed: int  # steps longer than the sample period
    missed_share: float
    histogram_edges_us: Signal  # (bins + 1,), µs, logarithmic
    histogram_counts: npt.NDArray[np.int64]  # (bins,), counts


@dataclass(frozen=True)
class LimitMet:
    """A limit that the drive met, and the longest stretch on it."""

    quantity: Literal["voltage", "slew"]
    limit: float  # V, or V/s
    value: float  # V, or V/s: the largest that was written while the limit was met
    share: float  # of the samples
    stretches: int  # number of stretches in which it was met
    time_s: float  # where the longest of them begins
    duration_s: float  # of the longest
    yd_um: float  # desired displacement at `time_s`


@dataclass(frozen=True)
class Drive:
    """One way of driving the stage along the trajectory, and its results."""

    label: str
    preview: int
    u: Signal  # (time,), V
    y_true: Signal  # (time,), µm
    y_sensor: Signal  # (time,), µm
    on_true: Tracking
    on_sensor: Tracking
    loop_width_um: float  # of y against y_d, steady part
    loop_width_percent: float  # of peak to peak
    saturated_share: float  # share of the samples with u at a voltage limit
    latency: Latency
    limits_met: tuple[LimitMet, ...] = ()
    beyond_trained_share: float | None = None  # share of the samples; None where that is not counted


@dataclass(frozen=True)
class Ratios:
    """How many times smaller the error on the true displacement is than without compensation."""

    loading_max: float
    loading_rms: float
    steady_max: float
    steady_rms: float
    whole_max: float
    whole_rms: float


@dataclass(frozen=True)
class LoopResult:
    """A trajectory run without compensation, with each compensator to compare, and with the compensator."""

    name: str
    title: str
    fs_hz: float
    t: Signal  # (time,), s
    yd: Signal  # (time,), µm
    loading_samples: int
    peak_to_peak_um: float
    range_low_um: float  # reached by the stage in its slow full-range loop
    range_high_um: float
    min_voltage_v: float
    max_voltage_v: float
    gain_um_per_v: float
    seed: int
    drives: dict[str, Drive]  # 'without', the compared ones, COMPENSATED last
    improvement: dict[str, Ratios]  # of each drive over 'without'
    notes: tuple[str, ...]

    @property
    def compensated(self) -> Drive:
        return self.drives[COMPENSATED]

    @property
    def without(self) -> Drive:
        return self.drives[WITHOUT]


WITHOUT = "without"
WITHOUT_LOOK_AHEAD = "without_same_look_ahead"
COMPENSATED = "torchpi"


def latency_of(step_ns: npt.NDArray[np.int64], period_s: float) -> Latency:
    """Summarise the nanoseconds of each step, (steps,), against the sample period."""
    step_us = step_ns / 1e3
    period_us = period_s * 1e6
    median, p99, p999 = np.percentile(step_us, [50.0, 99.0, 99.9])
    shortest = max(float(step_us.min()), 1e-3)
    longest = max(float(step_us.max()), 2 * shortest)
    first, last = math.floor(20 * math.log10(shortest)), math.ceil(20 * math.log10(longest))
    edges = 10.0 ** (np.arange(first, last + 1) / 20)  # 20 bins a decade
    counts, _ = np.histogram(np.maximum(step_us, edges[0]), edges)
    missed = int(np.count_nonzero(step_us > period_us))
    return Latency(
        steps=len(step_us),
        median_us=float(median),
        p99_us=float(p99),
        p999_us=float(p999),
        max_us=float(step_us.max()),
        period_us=period_us,
        missed=missed,
        missed_share=missed / len(step_us),
        histogram_edges_us=edges,
        histogram_counts=counts,
    )


def loading_samples(yd: Signal) -> int:
    """Count the samples before y_d first comes within 0.1 % of its maximum; until then the start matters."""
    return int(np.argmax(yd >= yd.max() - 1e-3 * np.ptp(yd)))


def loop_width(yd: Signal, y: Signal) -> float:
    """Return the widest spread of y at one y_d: the largest spread of y − y_d in any of 100 bins of y_d."""
    e = y - yd
    bins = np.minimum((100 * (yd - yd.min()) / max(np.ptp(yd), 1e-12)).astype(int), 99)
    high, low = np.full(100, -np.inf), np.full(100, np.inf)
    np.maximum.at(high, bins, e)
    np.minimum.at(low, bins, e)
    return float(np.max(high - low))


def as_json(result: LoopResult) -> dict[str, Any]:
    """Return the numbers, without the traces, under plain keys with units. Ratios over zero become null."""
    drives = {}
    for key, drive in result.drives.items():
        latency = drive.latency
        drives[key] = {
            "label": drive.label,
            "preview_samples": drive.preview,
            "true_displacement": dataclasses.asdict(drive.on_true),
            "sensor_reading": dataclasses.asdict(drive.on_sensor),
            "loop_width_um": drive.loop_width_um,
            "loop_width_percent": drive.loop_width_percent,
            "saturated_share": drive.saturated_share,
            "beyond_trained_share": drive.beyond_trained_share,
            "limits_met": [dataclasses.asdict(one) for one in drive.limits_met],
            "times_better_than_without": {
                key: ratio if math.isfinite(ratio) else None
                for key, ratio in dataclasses.asdict(result.improvement[key]).items()
            },
            "latency": {
                **dataclasses.asdict(latency),
                "histogram_edges_us": latency.histogram_edges_us.tolist(),
                "histogram_counts": latency.histogram_counts.tolist(),
            },
        }
    return {
        "name": result.name,
        "title": result.title,
        "sample_rate_hz": result.fs_hz,
        "samples": len(result.yd),
        "duration_s": len(result.yd) / result.fs_hz,
        "loading_s": result.loading_samples / result.fs_hz,
        "peak_to_peak_um": result.peak_to_peak_um,
        "range_um": [result.range_low_um, result.range_high_um],
        "voltage_limits_v": [result.min_voltage_v, result.max_voltage_v],
        "gain_um_per_v": result.gain_um_per_v,
        "seed": result.seed,
        "drives": drives,
        "notes": list(result.notes),
    }
