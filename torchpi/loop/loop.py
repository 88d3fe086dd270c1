"""Step a compensator against a stage, sample by sample, and measure how well the stage follows.

At tick k the compensator is given y_d[k + preview] and returns u_k; the stage gives the reading y_k, then
holds u_k until tick k + 1. The error is y_true[k] − y_d[k]: the motion at the tick against the motion that
was desired at that tick, so that every delay of the stage counts.
"""

import gc
import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from numbers import Real
from typing import Protocol

import numpy as np
import numpy.typing as npt
import torch

from torchpi.control.reach import check_reached
from torchpi.errors import ArtifactError, ConfigError, RecordingError, StageError
from torchpi.loop.limits_met import limits_met
from torchpi.loop.result import (
    COMPENSATED,
    WITHOUT,
    WITHOUT_LOOK_AHEAD,
    Drive,
    Error,
    LoopResult,
    Ratios,
    Signal,
    Tracking,
    latency_of,
    loading_samples,
    loop_width,
)

STEPS = ("sample_period_s", "preview", "reset", "step")
MOVES = ("sample_period_s", "min_voltage_v", "max_voltage_v", "seed", "stream")
COUNTERS = ("limited_outputs", "outside_range", "held_inputs")
"""Counts of voltages that its limits changed, samples beyond the trained range or rates, and held samples."""


class Compensator(Protocol):
    """Interface that the loop needs of a compensator; an exported TorchScript file has it.

    Optional attributes: `has_reference_filter: bool` (`step` then takes the raw reference y_r),
    `min_voltage_v` and `max_voltage_v` (its own output limits), and the counters since `reset`, `COUNTERS`.
    """

    sample_period_s: float
    preview: int  # samples that y_d is given ahead of its time

    def reset(self) -> None: ...
    def step(self, yd: float, /) -> float: ...  # µm -> V


class PlantStream(Protocol):
    """A stage that takes one sample at a time."""

    def reset(self, seed: int, /) -> None: ...
    def step(self, u: float, /) -> tuple[float, float]: ...  # V -> true displacement, sensor reading, µm


class Plant(Protocol):
    """Interface that the loop needs of a stage; `torchpi.stage.Stage` has it.

    Optional: `max_slew_v_s: float`, the slew limit of its amplifier.
    """

    @property
    def sample_period_s(self) -> float: ...
    @property
    def min_voltage_v(self) -> float: ...
    @property
    def max_voltage_v(self) -> float: ...
    @property
    def seed(self) -> int: ...
    def stream(self) -> PlantStream: ...


def run_loop(
    compensator: Compensator,
    stage: Plant,
    yd: Signal,  # (time,), µm
    *,
    fs_hz: float,
    name: str,
    title: str | None = None,
    yr: Signal | None = None,  # (time,), µm
    compare: Mapping[str, Compensator] | None = None,
    seed: int | None = None,
    max_slew_v_s: float = math.inf,
    clock: Callable[[], int] = time.perf_counter_ns,
    on_drive: Callable[[str], None] = lambda label: None,
) -> LoopResult:
    """Run a trajectory through the stage with a compensator, without one, and with others to compare.

    "Without" is u = y_d / gain, the gain being the straight line through the origin fitted by least squares
    to the stage's own slow loop (5 Hz sine over the full voltage range, sensor reading). If the compensator
    looks ahead, the same straight line is also run with the same look-ahead, to show how much of the
    improvement is due to look-ahead alone. Every run starts de-energised and meets the same noise.

    Args:
        compensator: the one to judge; `export.torchscript.load_torchscript` reads it from an exported file.
        stage: the stage to move.
        yd: the desired motion at each tick.
        fs_hz: sample rate of `yd`.
        name: short name of the trajectory, for files and keys.
        title: its name in a sentence; `name` if left out.
        yr: the reference before the filter of eq. 14, for compensators that hold the filter.
        compare: other compensators, by name.
        seed: seed of the stage's noise; None takes the stage's own.
        max_slew_v_s: limit of the voltage's rate in the amplifier; the stage's own slew limit counts as well.
        on_drive: called with the label of each run as it starts.
        clock: nanoseconds; reads the time before and after each `step`.

    Raises:
        StageError: if the stage has no voltage limits.
        ArtifactError: if sample periods differ, a compensator returns a voltage that is not finite, or
            `compensator` or `stage` lacks what the loop needs.
        RecordingError: if the trajectory is not finite, constant, or outside the stage's range.
        ConfigError: if `fs_hz` or `max_slew_v_s` is no positive number.

    Example:
        >>> import numpy as np
        >>> from torchpi import DirectInverse, Recording, Stage, run_loop
        >>> from torchpi.excitation import make_excitation
        >>> from torchpi.identification import fit_two_stage, inverse_pair
        >>> stage = Stage.from_yaml("default")
        >>> t, u = make_excitation("sine_5hz", stage.sample_rate_hz, 0.4)
        >>> pair = inverse_pair(Recording.from_arrays(t, u, stage.simulate(u[None])[1][0]))
        >>> inverse = DirectInverse(1e-4, [0.0, 0.1, 0.3, 0.8, 1.8], degree=3, range_um=8.0)
        >>> fitted = fit_two_stage(inverse, [pair])
        >>> yd = 3 - 3 * np.cos(2 * np.pi * 10 * t)  # µm
        >>> result = run_loop(inverse.stream(), stage, yd, fs_hz=stage.sample_rate_hz, name="sine")
        >>> {label: f"{drive.on_true.steady.rms_um:.2f} µm" for label, drive in result.drives.items()}
        {'without': '0.47 µm', 'torchpi': '0.25 µm'}
    """
    _check_offers("compensator", compensator, STEPS, "one that steps, such as DirectInverse.stream()")
    _check_offers("stage", stage, MOVES, "a stage, such as Stage.load(path)")
    for key, value, unit in (("fs_hz", fs_hz, "Hz"), ("max_slew_v_s", max_slew_v_s, "V/s")):
        if not (isinstance(value, Real) and value > 0):
            raise ConfigError(f"{key}: found {value!r}, expected a positive number of {unit}")
    compare = dict(compare or {})
    reserved = {WITHOUT, WITHOUT_LOOK_AHEAD, COMPENSATED} & compare.keys()
    if reserved:
        raise ArtifactError(f"compare: '{reserved.pop()}' is a name reserved by the loop: choose another")
    title = title or name
    _check_same_period(title, 1.0 / fs_hz, stage)
    for key, one in {COMPENSATED: compensator, **compare}.items():
        _check_same_period(key, one.sample_period_s, stage)
    yd = _checked_trajectory(title, yd)
    yr = yd if yr is None else _checked_trajectory(title, yr)

    seed = stage.seed if seed is None else seed
    plant = stage.stream()
    slow_loop = _slow_full_range_loop(stage, plant, seed)
    check_reached(title, yd, (slow_loop.low_um, slow_loop.high_um), "stage")

    straight: dict[str, Compensator] = {WITHOUT: _StraightLine(stage, slow_loop, preview=0)}
    if compensator.preview > 0:
        straight[WITHOUT_LOOK_AHEAD] = _StraightLine(stage, slow_loop, compensator.preview)

    max_slew_v_s = min(max_slew_v_s, getattr(stage, "max_slew_v_s", math.inf))
    rig = _Rig(stage, plant, yd, slow_loop, seed, clock, max_slew_v_s)
    with _garbage_collection_held():
        drives = {}
        for key, one in {**straight, **compare, COMPENSATED: compensator}.items():
            on_drive(_label(key))
            drives[key] = rig.drive(key, one, yr if getattr(one, "has_reference_filter", False) else yd)
    return LoopResult(
        name=name,
        title=title,
        fs_hz=fs_hz,
        t=np.arange(len(yd)) / fs_hz,
        yd=yd,
        loading_samples=rig.loading_samples,
        peak_to_peak_um=rig.peak_to_peak_um,
        range_low_um=slow_loop.low_um,
        range_high_um=slow_loop.high_um,
        min_voltage_v=stage.min_voltage_v,
        max_voltage_v=stage.max_voltage_v,
        gain_um_per_v=slow_loop.gain_um_per_v,
        seed=seed,
        drives=drives,
        improvement={key: _ratios(drives[WITHOUT].on_true, drive.on_true) for key, drive in drives.items()},
        notes=tuple(_notes(yd, rig.loading_samples)),
    )


# --- one drive ----------------------------------------------------------------------------------------------


class _Rig:
    """Drive a stage along a trajectory, and measure every drive by the same rule."""

    def __init__(
        self,
        stage: Plant,
        plant: PlantStream,
        yd: Signal,  # (time,), µm
        slow_loop: "_SlowLoop",
        seed: int,
        clock: Callable[[], int],
        max_slew_v_s: float,
    ) -> None:
        self.stage, self.plant, self.yd, self.seed, self.clock = stage, plant, yd, seed, clock
        self.max_slew_v_s = max_slew_v_s
        self.peak_to_peak_um = float(np.ptp(yd))
        self.range_um = slow_loop.high_um - slow_loop.low_um
        self.loading_samples = loading_samples(yd)

    def drive(
        self,
        key: str,
        compensator: Compensator,
        reference: Signal,  # (time,), µm
    ) -> Drive:
        preview = int(compensator.preview)
        u, y_true, y_sensor, step_ns, counts = _step_through(
            key, compensator, self.plant, _ahead(reference, preview), self.seed, self.clock
        )
        limited = None if counts is None else np.diff(counts[:, 0], prepend=0) > 0
        width = loop_width(self.yd[self.loading_samples :], y_true[self.loading_samples :])
        low = max(self.stage.min_voltage_v, getattr(compensator, "min_voltage_v", -math.inf))
        high = min(self.stage.max_voltage_v, getattr(compensator, "max_voltage_v", math.inf))
        return Drive(
            label=_label(key),
            preview=preview,
            u=u,
            y_true=y_true,
            y_sensor=y_sensor,
            on_true=self._tracking(y_true),
            on_sensor=self._tracking(y_sensor),
            loop_width_um=width,
            loop_width_percent=100.0 * width / self.peak_to_peak_um,
            saturated_share=float(np.mean((u <= low) | (u >= high))),
            latency=latency_of(step_ns, self.stage.sample_period_s),
            limits_met=limits_met(
                u,
                self.yd,
                y_true - self.yd,
                limited,
                low,
                high,
                self.max_slew_v_s,
                self.stage.sample_period_s,
            ),
            beyond_trained_share=None if counts is None else float(counts[-1, 1:].sum() / len(u)),
        )

    def _tracking(self, y: Signal) -> Tracking:
        e = y - self.yd
        # A trajectory that starts at its maximum has no loading part; the error of that part is then zero.
        return Tracking(
            loading=self._error(e[: self.loading_samples]),
            steady=self._error(e[self.loading_samples :]),
            whole=self._error(e),
        )

    def _error(self, e: Signal) -> Error:
        max_um = float(np.max(np.abs(e), initial=0.0))
        rms_um = float(np.sqrt(np.mean(e**2))) if e.size else 0.0
        return Error(
            max_um=max_um,
            rms_um=rms_um,
            max_percent=100.0 * max_um / self.peak_to_peak_um,
            rms_percent=100.0 * rms_um / self.peak_to_peak_um,
            max_percent_of_range=100.0 * max_um / self.range_um,
            rms_percent_of_range=100.0 * rms_um / self.range_um,
        )


def _step_through(
    key: str,
    compensator: Compensator,
    plant: PlantStream,
    feed: list[float],
    seed: int,
    clock: Callable[[], int],
) -> tuple[Signal, Signal, Signal, npt.NDArray[np.int64], npt.NDArray[np.int64] | None]:
    """Run the loop. Return u, y_true, y_sensor, the nanoseconds of each step, and the counters `COUNTERS`
    after each step, (time, 3), if the compensator has them."""
    u, y_true, y_sensor = (np.empty(len(feed)) for _ in range(3))
    step_ns = np.empty(len(feed), dtype=np.int64)
    step, move = compensator.step, plant.step
    compensator.reset()
    plant.reset(seed)
    counts = np.zeros((len(feed), len(COUNTERS)), np.int64) if hasattr(compensator, COUNTERS[0]) else None
    with torch.no_grad():
        for k, yd_ahead in enumerate(feed):
            start = clock()
            u_k = step(yd_ahead)
            step_ns[k] = clock() - start
            if not math.isfinite(u_k):
                raise ArtifactError(
                    f"{_label(key)}: the compensator returned {u_k} V at sample {k}; "
                    "expected a finite voltage: train it again, or export another checkpoint"
                )
            u[k] = u_k
            y_true[k], y_sensor[k] = move(u_k)
            if counts is not None:
                counts[k] = [getattr(compensator, name) for name in COUNTERS]
    return u, y_true, y_sensor, step_ns, counts


@contextmanager
def _garbage_collection_held() -> Iterator[None]:
    """Suspend garbage collection, which inside a step would be counted as the compensator's own time."""
    was_enabled = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.unfreeze()
        if was_enabled:
            gc.enable()


def _ahead(reference: Signal, preview: int) -> list[float]:
    """Return `reference[k + preview]` for every k, with the last value held past the end."""
    k = np.minimum(np.arange(len(reference)) + preview, len(reference) - 1)
    return [float(value) for value in reference[k]]


def _ratios(worse: Tracking, better: Tracking) -> Ratios:
    def ratio(a: float, b: float) -> float:
        return a / b if b > 0.0 else (math.inf if a > 0.0 else 1.0)

    return Ratios(
        **{
            f"{part}_{size}": ratio(
                getattr(getattr(worse, part), f"{size}_um"), getattr(getattr(better, part), f"{size}_um")
            )
            for part in ("loading", "steady", "whole")
            for size in ("max", "rms")
        }
    )


def _notes(yd: Signal, loading_samples: int) -> Iterator[str]:
    if abs(yd[0]) > 0.01 * np.ptp(yd):
        yield (
            f"The trajectory starts at {yd[0]:.3g} µm and the de-energised stage at 0: "
            "the loading error includes that jump."
        )
    if len(yd) - loading_samples < 0.1 * len(yd):
        yield (
            "The trajectory reaches its maximum in its last tenth, so the steady part is short; "
            "let it go up and down more than once."
        )


_LABELS = {
    WITHOUT: "without compensation",
    WITHOUT_LOOK_AHEAD: "without, same look-ahead",
    COMPENSATED: "torchpi",
}


def _label(key: str) -> str:
    return _LABELS.get(key, key.replace("_", " "))


# --- the stage by itself ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _SlowLoop:
    gain_um_per_v: float
    low_um: float
    high_um: float


def _slow_full_range_loop(stage: Plant, plant: PlantStream, seed: int) -> _SlowLoop:
    """Run two periods of a 5 Hz sine over the full voltage range; the second gives gain and range."""
    limits_v = (stage.min_voltage_v, stage.max_voltage_v)
    if not all(map(math.isfinite, limits_v)):
        raise StageError(
            f"stage: voltage limits of {limits_v[0]} and {limits_v[1]} V; expected finite ones, to run its "
            "full range: set min_voltage_v and max_voltage_v of its amplifier"
        )
    period = round(0.2 / stage.sample_period_s)
    phase = 2.0 * np.pi * np.arange(2 * period) / period
    middle = 0.5 * (stage.max_voltage_v + stage.min_voltage_v)
    amplitude = 0.5 * (stage.max_voltage_v - stage.min_voltage_v)
    u = middle - amplitude * np.cos(phase)  # V
    plant.reset(seed)
    y = np.array([plant.step(u_k) for u_k in u.tolist()])[:, 1]  # µm, as the sensor reads it
    u, y_last = u[period:], y[period:]
    return _SlowLoop(
        gain_um_per_v=float(u @ y_last / (u @ u)),
        low_um=min(0.0, float(y_last.min())),  # the de-energised stage stands at 0
        high_um=float(y_last.max()),
    )


class _StraightLine:
    """u = y_d / gain within the voltage limits: the drive without a compensator."""

    def __init__(self, stage: Plant, slow_loop: _SlowLoop, preview: int) -> None:
        self.sample_period_s = stage.sample_period_s
        self.preview = preview
        self._gain_um_per_v = slow_loop.gain_um_per_v
        self._low_v, self._high_v = stage.min_voltage_v, stage.max_voltage_v

    def reset(self) -> None:
        """Do nothing: a straight line has no memory."""

    def step(self, yd: float) -> float:
        return min(max(yd / self._gain_um_per_v, self._low_v), self._high_v)


# --- checks -------------------------------------------------------------------------------------------------


def _check_offers(name: str, found: object, needed: tuple[str, ...], expected: str) -> None:
    missing = [one for one in needed if not hasattr(found, one)]
    if missing:
        raise ArtifactError(
            f"{name}: found {type(found).__name__} without '{missing[0]}', expected {expected}"
        )


def _check_same_period(name: str, period_s: float, stage: Plant) -> None:
    if not math.isclose(period_s, stage.sample_period_s, rel_tol=1e-9):
        raise ArtifactError(
            f"{name}: sample period {period_s:.9g} s, but the stage's is {stage.sample_period_s:.9g} s; "
            "they must agree: use a stage file with this sample rate, or train at the stage's"
        )


def _checked_trajectory(name: str, y: Signal) -> Signal:
    y = np.asarray(y, dtype=np.float64)
    if y.ndim != 1 or len(y) < 10:
        raise RecordingError(
            f"{name}: a trajectory of shape {y.shape}; expected one row of 10 samples or more"
        )
    bad = np.flatnonzero(~np.isfinite(y))
    if bad.size:
        raise RecordingError(
            f"{name}: sample {bad[0]} is {y[bad[0]]}; expected a finite number: correct it or cut it out"
        )
    if np.ptp(y) == 0.0:
        raise RecordingError(f"{name}: the trajectory stays at {y[0]:.6g} µm; expected one that moves")
    return y
