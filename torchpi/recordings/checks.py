"""Checks whether a recording is fit for a model: unusable ones raise, questionable ones cause a warning.

Every message names the file, the value found, the value expected and the remedy.
"""

import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from torchpi.errors import RecordingError, RecordingWarning
from torchpi.recordings.faults import (
    dropouts,
    in_phase_correlation,
    lead_of_output,
    without_line,
)

if TYPE_CHECKING:
    from torchpi.recordings.recording import Recording

MIN_SAMPLES = 10
RELATED = 0.1  # correlation at the best lag; 0.1 means that 1 % of the output is explained
LONG_RUN = 4  # equal samples in a row; more than noise or a sharp peak produces
LEAST_STROKE_UM, LARGEST_STROKE_UM = 0.02, 1000.0
LEAST_RATE_HZ, LARGEST_RATE_HZ = 50.0, 5e6  # 1 to 50 kHz become 1 to 50 Hz if stamps in ms are read as s
LEAST_VOLTAGE_V, LARGEST_VOLTAGE_V = 0.005, 1500.0
LARGEST, LEAST_RANGE = 1e12, 1e-12  # in any unit; beyond them products of four values lose digits
CLEAR_GAIN = 0.5  # in-phase correlation above which the gain and its sign are not in doubt
AWAY_FROM_ZERO = 0.2  # share of the range; a de-energised stage keeps less than this from its last run


def check_recording(
    recording: "Recording",
    *,
    min_samples: int = MIN_SAMPLES,
    allow_constant_input: bool = False,
    place: Callable[[int], str] | None = None,
    check_start: bool = True,
) -> None:
    """Refuse a recording that no model can be identified from, and warn of defects that would spoil one.

    Args:
        recording: the recording, V and µm.
        min_samples: the fewest samples that the model needs.
        allow_constant_input: accept a hold, which shows creep, drift and noise but no hysteresis.
        place: describes, for the messages, where the sample of an index stands; by default `sample N`.
        check_start: whether the first sample is the start of the recording; False if the start was cut off.

    Raises:
        RecordingError: too short; NaN, infinity or an impossible magnitude; constant input; a flat or
            unplugged sensor.

    Warns:
        RecordingWarning: clipping, dropouts, an output that falls as the input rises or leads the input, a
            start away from zero, or a range or sample rate that suggests other units.
    """
    place = place or (lambda index: f"sample {index + 1}")
    name = recording.source or recording.name
    check_length(name, len(recording.u), min_samples)
    simulated = [] if recording.simulated is None else [("simulated_um", recording.simulated)]
    signals = [("input_v", recording.u), ("output_um", recording.y), *simulated, *recording.aux.items()]
    check_values(name, signals, place)
    for column, option, signal in (
        ("input", "input_unit", recording.u),
        ("output", "output_unit", recording.y),
    ):
        if 0 < np.ptp(signal) < LEAST_RANGE:
            raise RecordingError(
                f"{name}: the {column} moves by only {np.ptp(signal):.3g}, "
                f"expected at least {LEAST_RANGE:g}; "
                f"correct the column ({column}_column) or its unit ({option})"
            )
    if np.ptp(recording.u) == 0:
        if allow_constant_input:
            return
        raise RecordingError(
            f"{name}: the input is constant at {recording.u[0]:g} V, expected one that moves; "
            f"choose another column (input_column) or record with a moving voltage"
        )
    _check_sensor(name, recording)
    for warning in (
        _clipped_input(recording),
        _clipped_output(recording),
        _frozen_output(recording),
        _single_dropouts(recording, place),
        _falling_output(recording),
        _early_output(recording),
        _start_away(recording) if check_start else None,
        *_suspicious_units(recording),
    ):
        if warning:
            warnings.warn(f"{name}: {warning}", RecordingWarning, stacklevel=3)


def check_length(name: str, samples: int, min_samples: int) -> None:
    """Raise RecordingError if there are fewer samples than the model needs."""
    if samples < min_samples:
        raise RecordingError(
            f"{name}: {samples} samples, expected at least {min_samples} (min_samples); record for longer"
        )


def check_values(name: str, columns: list[tuple[str, np.ndarray]], place: Callable[[int], str]) -> None:
    """Raise RecordingError if a number is NaN, infinite, or larger than any rig records.

    Args:
        name: name of the file.
        columns: name and values (time,) of each column, all of one length.
        place: describes where the sample of an index stands.
    """
    bad = [~(np.abs(signal) <= LARGEST) for _, signal in columns]
    rows = np.any(bad, axis=0)
    if not rows.any():
        return
    first = int(np.argmax(rows))
    column, signal = next(columns[k] for k, mask in enumerate(bad) if mask[first])
    more = f" ({int(rows.sum())} such rows)" if rows.sum() > 1 else ""
    found = signal[first]
    expected = f"at most {LARGEST:g} in size" if np.isfinite(found) else "a finite number"
    raise RecordingError(
        f"{name}: {place(first)}: column '{column}': found {found:.6g}, expected {expected}{more}; "
        "correct the row, or delete it and interpolate with the option resample (true)"
    )


def _check_sensor(name: str, recording: "Recording") -> None:
    u, y = recording.u, recording.y
    remedy = "check the sensor's connection, its range and the column (output_column)"
    if np.ptp(y) == 0:
        raise RecordingError(
            f"{name}: the output is flat at {y[0]:g} µm while the input moves by {np.ptp(u):g} V; {remedy}"
        )
    levels = len(np.unique(y))
    if levels <= 4 and len(np.unique(u)) > 10 * levels:
        raise RecordingError(
            f"{name}: the output takes only {levels} values, {np.ptp(y):g} µm apart, while the input moves "
            f"by {np.ptp(u):g} V, expected a range of many sensor steps; {remedy}"
        )
    # By chance alone, n samples of noise reach a correlation of a few 1/√n at the best lag.
    least = min(0.35, max(RELATED, 3.5 / np.sqrt(len(u))))
    found = _correlation(u, y)
    if found < least:
        raise RecordingError(
            f"{name}: the output does not follow the input: correlation {found:.2f} at the best lag, "
            f"expected {least:.2f} or more; {remedy}"
        )


def _correlation(u: np.ndarray, y: np.ndarray) -> float:
    """Return the largest correlation at any lag up to an eighth of the record, with linear drift removed."""
    line_free = without_line(u)
    if line_free @ line_free > 0.01 * np.var(u) * len(u):
        u, y = line_free, without_line(y)
    else:  # the input is itself a ramp
        u, y = u - u.mean(), y - y.mean()
    scale = np.sqrt(float(u @ u) * float(y @ y))
    if scale == 0:
        return 0.0
    length = len(u)
    products = np.fft.irfft(np.fft.rfft(u).conj() * np.fft.rfft(y), n=length)
    lags = max(1, length // 8)
    return float(max(np.abs(products[:lags]).max(), np.abs(products[-lags:]).max()) / scale)


def _clipped_input(recording: "Recording") -> str | None:
    """Warn of flat tops that cut off a curve: longer than any hold elsewhere, and reached with a corner.

    Stairs also hold other levels, a trapezoid reaches its top along a straight line, and a deliberate hold is
    reached smoothly or by a jump.
    """
    u = recording.u
    start, length = _runs(u)
    inner = (start > 0) & (start + length < len(u))
    extreme = (u[start] == u.max()) | (u[start] == u.min())
    hold_elsewhere = int(length[inner & ~extreme].max(initial=1))
    clipped = inner & extreme & (length >= max(LONG_RUN, 8 * (hold_elsewhere - 1)))
    if not clipped.any():
        return None
    corners = [_is_cut_curve(u, int(i), int(n)) for i, n in zip(start[clipped], length[clipped], strict=True)]
    if np.mean(corners) < 0.3:  # a designed signal has none
        return None
    first = int(start[clipped][0])
    return (
        f"clipping: {_share(u, u[start[clipped]])} of the input samples lie at the limit, {u[first]:g} V "
        f"(first at t = {recording.t[first]:g} s); use a smaller amplitude or leave that part out"
    )


def _is_cut_curve(u: np.ndarray, start: int, length: int) -> bool:
    """Whether a curve runs into the flat top with a corner."""
    piece = max(2, length // 4)
    if start < 2 * piece:
        return False
    near = abs(u[start] - u[start - piece])
    far = abs(u[start - piece] - u[start - 2 * piece])
    if near <= 0.5 * far or near == 0:
        return False  # a smooth arrival: near/far is 1/3 for a parabola, 0.7 for a cut sine
    window = u[max(0, start - 100 * length) : start + 1]
    return any(_bends(window, part * np.ptp(u), 0.005 * np.ptp(u)) for part in (0.5, 0.9))


def _bends(window: np.ndarray, height: float, tolerance: float) -> bool:
    """Whether the last climb of this height, up to the end of the window, deviates from its chord."""
    below = np.flatnonzero(np.abs(window - window[-1]) > height)
    climb = window[below[-1] :] if len(below) else window[:0]
    if len(climb) < 4:
        return False  # a jump, or no such climb
    return bool(np.abs(climb - np.linspace(climb[0], climb[-1], len(climb))).max() > tolerance)


def _clipped_output(recording: "Recording") -> str | None:
    """Warn of constant stretches at the output's extreme values that begin before the input reverses.

    A play stands still only after the reversal; a rounded peak stands still only while the input crosses one
    sensor step.
    """
    u, y = recording.u, recording.y
    start, length = _runs(y)
    direction = np.sign(without_line(u) @ without_line(y)) or 1.0
    one_step_u = recording.output_step_um / np.ptp(y) * np.ptp(u)
    outward = max(1e-3 * np.ptp(u), 3 * one_step_u)
    inner = (start > 0) & (start + length < len(y)) & (length >= LONG_RUN)
    clipped = np.zeros(len(start), dtype=bool)
    for side, limit in ((direction, y.max()), (-direction, y.min())):
        drive = side * u
        clipped |= inner & (y[start] == limit) & (np.maximum.reduceat(drive, start) - drive[start] > outward)
    if not clipped.any():
        return None
    first = int(start[clipped][0])
    return (
        f"clipping: {_share(y, y[start[clipped]])} of the output samples lie at the sensor's limit, "
        f"{y[first]:g} µm (first at t = {recording.t[first]:g} s), while the input moves on; "
        f"use a smaller amplitude or another sensor range, or leave that part out"
    )


def _frozen_output(recording: "Recording") -> str | None:
    """Warn if the output is constant, then jumps, while the input moves by many sensor steps per sample."""
    u, y = recording.u, recording.y
    start, length = _runs(y)
    start, length = start[:-1], length[:-1]  # what follows the last run is unknown
    after = start + length
    step_um = np.abs(u[after] - u[start]) / length * (np.ptp(y) / np.ptp(u))  # expected change per sample
    jump_um = np.abs(y[after] - y[after - 1])
    inside = (y[start] != y.max()) & (y[start] != y.min())  # the extremes are left to the check for clipping
    frozen = (length >= 3) & inside & (step_um > 5 * recording.output_step_um) & (jump_um > 1.5 * step_um)
    repeated = int((length[frozen] - 1).sum())
    if not frozen.any() or (length[frozen].max() < 10 and repeated < 0.02 * len(y)):
        return None
    longest = int(np.flatnonzero(frozen)[np.argmax(length[frozen])])
    return (
        f"dropouts: {100 * repeated / len(y):.2g} % of the output samples repeat the previous one "
        f"while the input moves (the longest, {length[longest]} samples, "
        f"at t = {recording.t[start[longest]]:g} s); leave that part out, or record at the sensor's own rate"
    )


def _single_dropouts(recording: "Recording", place: Callable[[int], str]) -> str | None:
    """Warn of single readings that neither noise nor motion explains."""
    found = dropouts(recording.y, recording.u, recording.output_step_um)
    if not len(found):
        return None
    first = int(found[0])
    y = recording.y[first - 1 : first + 2]
    others = ", ".join(place(int(index)) for index in found[1:4])
    more = f" and {len(found) - 4} more" if len(found) > 4 else ""
    return (
        f"dropouts: {len(found)} single wrong {'readings' if len(found) > 1 else 'reading'} of the output "
        f"({place(first)}: {y[1]:.6g} µm between {y[0]:.6g} and {y[2]:.6g} µm"
        f"{'; ' + others if others else ''}{more}); delete these rows and interpolate with the option "
        "resample (true)"
    )


def _falling_output(recording: "Recording") -> str | None:
    found = in_phase_correlation(recording.u, recording.y)
    if found > -CLEAR_GAIN:
        return None
    return (
        f"the output falls when the input rises (correlation {found:.2f}); if the sensor counts downwards, "
        "reverse its sign with the option output_unit (-1 for µm, -0.001 for nm)"
    )


def _early_output(recording: "Recording") -> str | None:
    lead = lead_of_output(recording.u, recording.y)
    # A stage may seem to lead above its resonances, or if other inputs drive it as well.
    if not lead or abs(in_phase_correlation(recording.u, recording.y)) < CLEAR_GAIN:
        return None
    degrees = np.degrees(np.arcsin(min(1.0, lead / 1.11)))
    return (
        f"the output leads the input (by about {degrees:.2g}° of a cycle), which no stage can do; exchange "
        "the columns (input_column, output_column) if they are swapped, or synchronise their clocks"
    )


def _start_away(recording: "Recording") -> str | None:
    start, stroke = float(recording.y[0]), float(np.ptp(recording.y))
    if abs(start) <= AWAY_FROM_ZERO * stroke:
        return None
    return (
        f"starts at {start:.4g} µm with a range of {stroke:.4g} µm, away from the de-energised state; "
        "if that is only the sensor's zero, count from the first sample with the option zero (first); "
        "in training, model.offset: true learns it as well"
    )


def _suspicious_units(recording: "Recording") -> list[str]:
    stroke, voltage = float(np.ptp(recording.y)), float(np.ptp(recording.u))
    found = []
    if not LEAST_RATE_HZ <= recording.fs_hz <= LARGEST_RATE_HZ:
        meant = "ms or us" if recording.fs_hz < LEAST_RATE_HZ else "s"
        found.append(
            f"sampled at {recording.fs_hz:.4g} Hz for {recording.duration_s:.4g} s; "
            f"if the time stamps are in {meant}, give time_unit"
        )
    if stroke < LEAST_STROKE_UM:
        meant = "m" if stroke < 0.0005 else "mm"
        found.append(
            f"the output moves by only {stroke:.3g} µm; if the file is in {meant}, give output_unit {meant}"
        )
    if stroke > LARGEST_STROKE_UM:
        found.append(f"the output moves by {stroke:.3g} µm; if the file is in nm, give output_unit nm")
    if voltage < LEAST_VOLTAGE_V:
        found.append(f"the input moves by only {voltage:.3g} V; if the file is in kV, give input_unit kV")
    if voltage > LARGEST_VOLTAGE_V:
        found.append(f"the input moves by {voltage:.4g} V; if the file is in mV, give input_unit mV")
    return found


def _runs(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the start and length of every run of equal samples."""
    start = np.concatenate(([0], np.flatnonzero(x[1:] != x[:-1]) + 1))
    return start, np.diff(np.append(start, len(x)))


def _share(x: np.ndarray, limits: np.ndarray) -> str:
    return f"{100 * np.isin(x, limits).mean():.2g} %"
