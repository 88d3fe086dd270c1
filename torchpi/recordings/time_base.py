"""Checked signals of a file on one uniform time base: first step of `read_recording` and `read_signal`."""

import re
import warnings
from typing import NamedTuple

import numpy as np

from torchpi.errors import RecordingError, RecordingWarning
from torchpi.recordings.checks import check_length, check_values
from torchpi.recordings.options import (
    INPUT_COLUMN,
    OUTPUT_COLUMN,
    SIMULATED_COLUMN,
    TIME_COLUMN,
    RecordingOptions,
)
from torchpi.recordings.readers import Source
from torchpi.recordings.readers.header import (
    SIMULATED,
    UNITS,
    Role,
    columns_for,
    known_unit,
    role_of_unit,
    stem_and_unit,
)
from torchpi.recordings.readers.source import Column, shortened
from torchpi.recordings.readers.time_stamps import Grid, round_rate, uniform_grid

RATE_TOLERANCE = 5e-3  # largest relative uncertainty of the sample rate from coarse time stamps
RATE_AGREEMENT = 1e-4  # relative, between the stamps and a rate that the user gives
LEAST_STEP_S, LONGEST_S = 1e-12, 1e12
SAME_TICK = 0.25  # of the period: rows whose spacing is this close to whole periods are one row per tick
MOST_FILLED = 100  # largest factor by which interpolation may increase the number of samples
DEFAULTS: dict[Role, str] = {"time": TIME_COLUMN, "input": INPUT_COLUMN, "output": OUTPUT_COLUMN}


class Uniform(NamedTuple):
    """Signals on one uniform time base."""

    t: np.ndarray  # (time,), s
    fs_hz: float
    signals: list[np.ndarray]  # (time,) each, in the file's own units
    rows: list[np.ndarray] | None = None
    """The signals as in the rows of the file, if samples were interpolated between rows or filled in."""
    filled: np.ndarray | None = None
    """(time,), whether no row lies within half a sample; None if every sample has one."""
    late_s: np.ndarray | None = None
    """(time,), s: how late each sample's row is on a regular clock; None if the clock does not jitter."""


NUMBERED = re.compile(r"(input|output)_\d+(_|$)")
"""Names of the columns of a recording of several axes."""


def column_of(source: Source, column: Column, role: Role) -> str:
    """Return the name of this column in the file; for a default name, the only column that fits the role.

    Raises:
        RecordingError: there is none, or several columns fit.
    """
    if column == DEFAULTS[role] and column not in source.names:
        found = columns_for(role, ((name, source.unit(name)) for name in source.names))
        if len(found) == 1:
            return found[0]
        if found:
            raise RecordingError(
                f"{source.path}: {' and '.join(repr(name) for name in found[:4])} may each be the {role}; "
                f"choose one with the option {role}_column"
            )
        if several := [name for name in source.names if NUMBERED.match(name)]:
            raise RecordingError(
                f"{source.path}: found a recording of several axes ({', '.join(several[:4])}), expected one "
                f"{role}; choose one with the option {role}_column, or use check, diagnose, predict, or a "
                "config with multi_axis"
            )
    return source.find(column, f"{role}_column")


def simulated_column(source: Source) -> str:
    """Return the name of the column with a simulator's output, `simulated_um` or in another unit.

    Raises:
        RecordingError: there is none.
    """
    if SIMULATED_COLUMN in source.names:
        return SIMULATED_COLUMN
    found = [name for name in source.names if stem_and_unit(name)[0] == SIMULATED]
    if len(found) != 1:
        raise RecordingError(
            f"{source.path}: found {len(found)} columns '{SIMULATED}…' among {shortened(source.names)}, "
            f"expected one, {SIMULATED_COLUMN}, with the simulator's response to the voltage"
        )
    return found[0]


def scale_of(
    source: Source, name: str, role: Role, unit: float | str | None, option: str | None = None
) -> tuple[float, float]:
    """Return the scale (times, by), ours = theirs · times / by, of the unit given, else stated, else our own.

    Raises:
        RecordingError: an unknown unit, or a column whose stated unit is of another quantity.
    """
    option = option or f"{role}_unit"
    stated = source.unit(name)
    if unit is None and stated is not None and role_of_unit(stated) != role:
        raise RecordingError(
            f"{source.path}: column '{name}' is in {stated}, expected {', '.join(UNITS[role])}; "
            f"choose another column, or give the scale with the option {option}"
        )
    if unit is None:
        return UNITS[role][stated] if stated else (1, 1)
    known = known_unit(str(unit))
    if known in UNITS[role]:
        return UNITS[role][known]
    try:
        factor = 0.0 if isinstance(unit, bool) else float(unit)
    except (TypeError, ValueError):
        factor = 0.0
    if factor == 0 or not 1e-12 <= abs(factor) <= 1e12 or (role == "time" and factor < 0):
        raise RecordingError(
            f"{source.path}: {option} is '{unit}', expected one of {', '.join(UNITS[role])}, "
            "or a number that is not zero"
        )
    return factor, 1


def converted(x: np.ndarray, scale: tuple[float, float]) -> np.ndarray:
    """Return x in our unit."""
    times, by = scale
    return x if times == by else x * times / by


def rate_of(source: Source, fs_hz: float | str | None) -> float | None:
    """Return the sample rate that the user gave, Hz, as a number or as the name of one in the file."""
    if fs_hz is None:
        return None
    try:
        rate = float(fs_hz)
    except (TypeError, ValueError):
        stored = source.scalar(str(fs_hz))
        if stored is None:
            raise RecordingError(
                f"{source.path}: fs_hz is '{fs_hz}', expected a number in Hz or the name of one in the file"
            ) from None
        rate = stored
    if not 1 / LONGEST_S <= rate <= 1 / LEAST_STEP_S:
        raise RecordingError(f"{source.path}: fs_hz is {rate:g}, expected a sample rate over 0 Hz")
    return rate


def time_stamps(source: Source, options: RecordingOptions) -> tuple[str, np.ndarray] | None:
    """Return (name, (time,) in s) of the column of time stamps; None if the options or the file have none."""
    name = _time_name(source, options.time_column, rate_of(source, options.fs_hz))
    if name is None:
        return None
    (t,) = source.read([name])
    return name, converted(t, scale_of(source, name, "time", options.time_unit))


def read_uniform(source: Source, names: list[str], options: RecordingOptions, min_samples: int) -> Uniform:
    """Read time, sample rate and the signals of these names: finite, of one length, uniformly sampled.

    Raises:
        RecordingError: states in one line what is wrong, in which row and column, and what to do.
    """
    rate = rate_of(source, options.fs_hz)
    time_name = _time_name(source, options.time_column, rate)
    signals = source.read(names + ([time_name] if time_name else []))
    all_names = [*names, time_name] if time_name else names
    _check_lengths(source, all_names, signals)
    check_length(source.path, len(signals[0]), max(2, min_samples))
    if time_name:
        signals[-1] = converted(signals[-1], scale_of(source, time_name, "time", options.time_unit))
    check_values(source.path, list(zip(all_names, signals, strict=True)), source.place)
    t = signals.pop() if time_name else None
    if t is None and options.time_column is not None and rate is None:
        t = _own_times(source, names)
    if t is None:
        if rate is None:
            raise RecordingError(
                f"{source.path}: no time stamps and no sample rate; "
                "give the rate (fs_hz) or a time column (time_column)"
            )
        return Uniform(np.arange(len(signals[0])) / rate, rate, signals)
    _check_extent(source, t)
    grid = uniform_grid(t)
    if grid.odd_sample is not None:
        if not options.resample:
            raise _not_uniform(source, grid, t)
        return _interpolated(source, grid, t, signals)
    if grid.rate_uncertainty > RATE_TOLERANCE and rate is None:
        raise RecordingError(
            f"{source.path}: the time stamps determine the sample rate only to within "
            f"{100 * grid.rate_uncertainty:.2g} %, "
            f"expected {100 * RATE_TOLERANCE:g} %; write more digits or give the rate (fs_hz)"
        )
    if rate is None or abs(grid.fs_hz / rate - 1) <= RATE_AGREEMENT + grid.rate_uncertainty:
        return Uniform(t, rate or grid.fs_hz, signals)
    if not options.resample:
        raise RecordingError(
            f"{source.path}: the time stamps give {grid.fs_hz:.9g} Hz, but fs_hz is {rate:.9g} Hz; "
            "leave out fs_hz, convert the recording to it with the option resample (true), "
            f"or ignore the time stamps with time_column null"
        )
    return Uniform(t, grid.fs_hz, signals)


def _time_name(source: Source, column: Column | None, rate: float | None) -> str | None:
    if column is None:
        return None
    default_is_missing = column == TIME_COLUMN and TIME_COLUMN not in source.names
    if default_is_missing and (rate is not None or source.has_times):
        found = columns_for("time", ((name, source.unit(name)) for name in source.names))
        return found[0] if len(found) == 1 else None
    try:
        return column_of(source, column, "time")
    except RecordingError as error:
        raise RecordingError(f"{error}, or give the sample rate with fs_hz") from None


def _own_times(source: Source, names: list[str]) -> np.ndarray | None:
    """Return the time base that the format stores for the first signal; the other signals must share it."""
    first = source.times(names[0])
    for name in names[1:]:
        other = source.times(name)
        if (first is None) != (other is None) or (
            first is not None and other is not None and not np.allclose(first, other, rtol=0, atol=1e-9)
        ):
            raise RecordingError(
                f"{source.path}: '{names[0]}' and '{name}' have different time bases, expected one; "
                f"export both at one common rate, or give the rate (fs_hz)"
            )
    return first


def _check_lengths(source: Source, names: list[str], signals: list[np.ndarray]) -> None:
    if len({len(signal) for signal in signals}) > 1:
        found = ", ".join(f"'{name}' {len(signal)}" for name, signal in zip(names, signals, strict=True))
        raise RecordingError(
            f"{source.path}: unequal lengths: {found} samples, expected one length; export them together"
        )


def _check_extent(source: Source, t: np.ndarray) -> None:
    """Refuse time steps that no rig has: they would overflow, or give no sample rate, later on."""
    steps = np.diff(t)
    short = (steps > 0) & (steps < LEAST_STEP_S)
    if short.any():
        first = int(np.argmax(short)) + 1
        raise RecordingError(
            f"{source.path}: {source.place(first)}: time step {steps[first - 1]:g} s, expected at least "
            f"{LEAST_STEP_S:g} s; correct the column (time_column) or its unit (time_unit)"
        )


def _not_uniform(source: Source, grid: Grid, t: np.ndarray) -> RecordingError:
    where = source.place(grid.odd_sample or 0)
    found = f"{source.path}: {where}: time step {grid.step_s:.6g} s, median step {grid.median_step_s:.6g} s"
    if np.any(np.diff(t) <= 0):
        backward = int(np.argmax(np.diff(t) <= 0)) + 1
        return RecordingError(
            f"{source.path}: {source.place(backward)}: time goes from {t[backward - 1]:.9g} s to "
            f"{t[backward]:.9g} s, "
            f"expected an increase (median step {grid.median_step_s:.6g} s); sort or delete rows, "
            f"or give the sample rate (fs_hz) with time_column null"
        )
    return RecordingError(
        f"{found}, expected uniform sampling; the option resample (true) brings it to a uniform grid"
    )


def _interpolated(source: Source, grid: Grid, t: np.ndarray, signals: list[np.ndarray]) -> Uniform:
    steps = np.diff(t)
    if np.any(steps <= 0):
        raise _not_uniform(source, grid, t)
    usual = np.abs(steps - grid.median_step_s) < 0.5 * grid.median_step_s
    rate = round_rate(float(steps[usual].mean() if usual.any() else grid.median_step_s), 1e-3)
    longest = int(np.argmax(steps))
    samples = int(np.floor((t[-1] - t[0]) * rate + 1e-6)) + 1
    if samples > MOST_FILLED * len(t):
        raise RecordingError(
            f"{source.path}: {source.place(longest + 1)}: a gap of {steps[longest]:.3g} s at a median step "
            f"of {grid.median_step_s:.3g} s, expected at most {MOST_FILLED} times as many samples once gaps "
            "are filled; cut the recording there"
        )
    if steps[longest] > 3 * grid.median_step_s:
        warnings.warn(
            f"{source.path}: {source.place(longest + 1)}: a gap of {steps[longest]:.3g} s "
            f"({100 * steps[longest] / (t[-1] - t[0]):.2g} % of the recording) is filled with a "
            "straight line; "
            f"leave that part out if it matters",
            RecordingWarning,
            stacklevel=4,
        )
    whole = np.rint(steps / grid.median_step_s)
    near = np.abs(steps / grid.median_step_s - whole).max() < SAME_TICK
    if len(signals) > 1 and near and whole.min() > 0:
        return _at_ticks(t, rate, np.concatenate([[0], np.cumsum(whole).astype(int)]), signals)
    uniform = t[0] + np.arange(samples) / rate
    after = np.clip(np.searchsorted(t, uniform), 1, len(t) - 1)
    filled = np.minimum(np.abs(t[after] - uniform), np.abs(t[after - 1] - uniform)) > 0.5 / rate
    interpolated = [np.interp(uniform, t, signal) for signal in signals]
    return Uniform(uniform, rate, interpolated, signals, filled if filled.any() else None)


def _at_ticks(t: np.ndarray, rate: float, ticks: np.ndarray, signals: list[np.ndarray]) -> Uniform:
    """Assign the rows unchanged to the ticks of a loop whose clock jitters; fill ticks without a row.

    Interpolating would smooth fast signals by a varying amount, depending on how far each instant lies from
    the rows. This keeps the relation of signals sampled together; a single signal has only its times.
    """
    every = np.arange(ticks[-1] + 1)
    missing = ~np.isin(every, ticks)
    placed = [np.interp(every, ticks, signal) for signal in signals]
    rows, filled = (signals, missing) if missing.any() else (None, None)
    late_s = np.interp(every, ticks, t - np.polyval(np.polyfit(ticks, t, 1), ticks))
    return Uniform(t[0] + every / rate, rate, placed, rows, filled, late_s)
