"""Identify an oscillator with Bouc–Wen hysteresis from recordings of force and displacement.

Mass, damping and stiffness are estimated from the frequency response, the best linear approximation (Pintelon
and Schoukens, System Identification, 2012). The search for the hysteresis starts from several shares of that
stiffness and several loop shapes. Each start is fitted for a few steps to the beginning of one recording, and
the best to all samples of all recordings, simulated from rest, by nonlinear least squares of the output
error. The residuals decide how the force is interpolated between its samples, and whether the exponent
differs from one. For black-box models of the same oscillator: Noël, Esfahani, Kerschen and Schoukens, Mech.
Syst. Signal Process. 84, 2017.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.optimize import OptimizeResult, least_squares
from scipy.signal import csd, welch

from torchpi.errors import ConfigError, RecordingError, StageError, is_number
from torchpi.operators.bouc_wen_oscillator import BETWEEN_SAMPLES, BoucWenParameters
from torchpi.recordings.recording import Recording
from torchpi.stage.bouc_wen_oscillator import STEPS, UM_PER_M, BoucWenOscillator

SEARCHED = 4096
"""Number of samples that are simulated in the search for a start."""
SEARCH_STEPS = 6
"""Integration steps per sample in that search."""
SEARCH_TRIALS, BETTER, TRIALS = 6, 3, 60
OPEN = tuple(
    (1 - share, share, wide, bent)
    for share, wide, bent in itertools.product((0.3, 0.6), (0.4, 1.2), (-1.0, 0.0, 0.5))
)
"""Starts: elastic and hysteretic stiffness over the linear one, g z / α at its rms force z, and d / g."""
SATURATED = tuple((0.95, 0.3, wide, 0.0) for wide in (6.0, 30.0))
"""Starts with a hysteretic force that saturates well below that, as dry friction does."""
LEAST_SAMPLES = 256
LEAST_COHERENCE = 0.2
MOST_LEFT = 0.9
"""Largest residual, as a share of a recording's rms: an oscillator that leaves more explains nothing."""
DIFFERENCE = 1e-6
"""Relative step of the finite differences that approximate derivatives."""
DIVERGED = 10.0
"""Error assigned to a diverged solution, as a multiple of the recorded displacement."""
INTERVAL = 1.96
"""Half-width of a 95 % interval, in standard deviations."""
LEAST_EXPONENT, LARGEST_EXPONENT = 0.5, 6.0


@dataclass(frozen=True)
class OscillatorOptions:
    """Options of the identification.

    Args:
        between: Interpolation of the force between its samples: `band_limited`, `linear` or `held`; null
            takes the one with the smallest residual.
        exponent: ν; null means one, unless Schwarz's criterion (1978) favours fitting it.
    """

    between: str | None = None
    exponent: float | None = None

    def __post_init__(self) -> None:
        if self.between is not None and self.between not in BETWEEN_SAMPLES:
            raise ConfigError(
                f"between: found {self.between!r}, expected one of {', '.join(BETWEEN_SAMPLES)}"
            )
        exponent, low, high = self.exponent, LEAST_EXPONENT, LARGEST_EXPONENT
        if exponent is not None and not (is_number(exponent) and low <= exponent <= high):
            raise ConfigError(f"exponent: found {exponent!r}, expected a number from {low:g} to {high:g}")


@dataclass(frozen=True)
class IdentifiedOscillator:
    """Result of the identification.

    Attributes:
        oscillator: The identified stage.
        half_widths: Half of the 95 % interval of each parameter, for white noise; None if it was not fitted.
        rms_um: Rms output error on the searched stretch, by interpolation of the force between its samples.
    """

    oscillator: BoucWenOscillator
    half_widths: dict[str, float | None]
    rms_um: dict[str, float]


class Scale(NamedTuple):
    """Reference values that the fitted parameters are relative to."""

    mass_kg: float
    damping_n_s_m: float
    stiffness_n_m: float
    force_n: float


@dataclass(frozen=True)
class OutputError:
    """Residual to minimise: recorded minus simulated displacement, each from rest, with its mean removed.

    θ = (log m, c, log k, log α, g z^ν / α, d z^ν / α[, ν]), relative to the scale, whose force is z.

    Attributes:
        recordings: Force and displacement.
        counted: Masks of the samples that count, (time,) each.
        scale: Reference values of θ.
        between: Interpolation of the force between its samples.
        steps: Integration steps per sample.
        exponent: ν if it is not fitted.
    """

    recordings: Sequence[Recording]
    counted: Sequence[np.ndarray]
    scale: Scale
    between: Any
    steps: int
    exponent: float | None

    def parameters(self, theta: np.ndarray) -> BoucWenParameters:
        scale, nu = self.scale, float(theta[6]) if self.exponent is None else self.exponent
        alpha = scale.stiffness_n_m * math.exp(theta[3])
        curve = alpha / scale.force_n**nu
        return BoucWenParameters(
            scale.mass_kg * math.exp(theta[0]),
            scale.damping_n_s_m * float(theta[1]),
            scale.stiffness_n_m * math.exp(theta[2]),
            alpha,
            float(theta[4]) * curve,
            float(theta[5]) * curve,
            nu,
        )

    def oscillator(self, theta: np.ndarray, offset_um: float = 0.0) -> BoucWenOscillator:
        values = self.parameters(theta)._asdict()
        return BoucWenOscillator(self.recordings[0].fs_hz, values, self.between, self.steps, offset_um)

    def raw(self, theta: np.ndarray) -> np.ndarray:
        """Return the error before its mean is subtracted, (counted samples of all,), µm."""
        oscillator, errors = self.oscillator(theta), []
        for one, counted in zip(self.recordings, self.counted, strict=True):
            try:
                error = one.y - oscillator.simulate(torch.from_numpy(one.u)[None])[0].numpy()
            except StageError:  # diverged
                error = DIVERGED * one.y
            errors.append(error[counted])
        return np.concatenate(errors)

    def __call__(self, theta: np.ndarray) -> np.ndarray:
        error = self.raw(theta)
        error -= error.mean()
        return error

    def slopes(self, theta: np.ndarray) -> np.ndarray:
        """Return the Jacobian, (counted samples of all, parameters), by differences: θ is of order one."""
        error = self(theta)
        steps = DIFFERENCE * np.eye(len(theta))
        return np.stack([(self(theta + step) - error) / DIFFERENCE for step in steps], 1)

    def descend(self, theta: np.ndarray, trials: int) -> OptimizeResult:
        """Run trust-region reflective least squares (Branch, Coleman and Li, 1999) from θ."""
        low = [-5.0, 0.0, -12.0, -12.0, 0.0, -np.inf, LEAST_EXPONENT][: len(theta)]
        high = [5.0, np.inf, 5.0, 5.0, np.inf, np.inf, LARGEST_EXPONENT][: len(theta)]
        return least_squares(
            self, theta, self.slopes, (low, high), x_scale="jac", max_nfev=trials, xtol=1e-10, ftol=1e-10
        )

    def rms(self, theta: np.ndarray) -> float:
        """Return the rms error, µm."""
        return float(np.sqrt(np.mean(np.square(self(theta)))))


def identify_oscillator(
    recordings: Sequence[Recording],
    counted: Sequence[np.ndarray] | None = None,
    options: OscillatorOptions | None = None,
    log: Callable[[str], None] = lambda text: None,
) -> IdentifiedOscillator:
    """Identify one oscillator for all recordings.

    Args:
        recordings: Force, N, and displacement, µm, at one sample rate, each from rest.
        counted: Samples of each recording whose displacement is fitted, (time,), bool; by default all.
        options: Options of the identification.
        log: Called with each line of progress.

    Raises:
        RecordingError: The recordings differ in sample rate, are too short, or show no mode.
    """
    options = options or OscillatorOptions()
    counted = [np.ones(len(one), dtype=bool) for one in recordings] if counted is None else counted
    _check(recordings, counted)
    mass, damping, stiffness = linear_oscillator(recordings, counted)
    frequency = math.sqrt(stiffness / mass) / (2 * math.pi)
    log(f"linear: {frequency:.4g} Hz, mass {mass:.4g} kg, stiffness {stiffness:.4g} N/m")
    motions = [float(one.y[counts].std()) for one, counts in zip(recordings, counted, strict=True)]
    largest = int(np.argmax(motions))
    force = stiffness * motions[largest] / UM_PER_M
    exponent = 1.0 if options.exponent is None else options.exponent
    short, short_counted = _head(recordings[largest], counted[largest])
    search = OutputError(
        [short],
        [short_counted],
        Scale(mass, damping, stiffness, force),
        options.between or "band_limited",
        SEARCH_STEPS,
        exponent,
    )
    theta = best_start(search, log)
    rms_um = {}
    for between in BETWEEN_SAMPLES if options.between is None else (options.between,):
        other = replace(search, between=between)
        rms_um[between] = other.rms(other.descend(theta, 2 * SEARCH_TRIALS).x)
        log(f"force between the samples {between}: {rms_um[between]:.4g} µm rms")
    between = min(rms_um, key=lambda name: rms_um[name])
    full = replace(search, recordings=recordings, counted=counted, between=between, steps=STEPS)
    found = full.descend(theta, TRIALS)
    log(f"all samples, ν = {exponent:g}: {full.rms(found.x):.5g} µm rms")
    if options.exponent is None:
        free = replace(full, exponent=None)
        other = free.descend(np.append(found.x, exponent), TRIALS)
        log(f"all samples, ν = {other.x[6]:.4f}: {free.rms(other.x):.5g} µm rms")
        samples = len(other.fun)
        if samples * math.log(found.cost / other.cost) > math.log(samples):
            full, found = free, other
    offset = float(full.raw(found.x).mean())
    return IdentifiedOscillator(full.oscillator(found.x, offset), _half_widths(full, found), rms_um)


def best_start(search: OutputError, log: Callable[[str], None]) -> np.ndarray:
    """Return the best θ found from several starts.

    Raises:
        RecordingError: Even the best start explains nothing.
    """
    found = []
    for elastic, hysteretic, wide, bent in (*OPEN, *SATURATED):
        theta = np.array([0.0, 0.5, math.log(elastic), math.log(hysteretic), wide, wide * bent])
        found.append(search.descend(theta, SEARCH_TRIALS))
    found = sorted(found, key=lambda one: float(one.cost))[:BETTER]
    best = min((search.descend(one.x, TRIALS) for one in found), key=lambda one: float(one.cost))
    rms_um, motion_um = search.rms(best.x), float(search.recordings[0].y[search.counted[0]].std())
    log(f"start: {rms_um:.4g} µm rms of {motion_um:.4g} µm")
    if rms_um > MOST_LEFT * motion_um:
        raise RecordingError(
            f"{search.recordings[0].name}: found a residual of {rms_um:.4g} µm rms of {motion_um:.4g} µm, "
            "expected a displacement that the force explains by one mode"
        )
    return np.asarray(best.x)


def linear_oscillator(
    recordings: Sequence[Recording], counted: Sequence[np.ndarray]
) -> tuple[float, float, float]:
    """Return mass, kg, damping, N s/m, and stiffness, N/m, of the best linear approximation.

    The frequency response H is estimated from averaged spectra, and |1 - H (k - m ω² + i c ω)|² is minimised
    over k, m and c at the frequencies where force and displacement are coherent.

    Raises:
        RecordingError: The response shows no mode.
    """
    stretches = [
        (one.u[part], one.y[part] / UM_PER_M)
        for one, counts in zip(recordings, counted, strict=True)
        for part in _runs(counts)
    ]
    longest = max(len(u) for u, _ in stretches)
    length = 2 * max(LEAST_SAMPLES // 2, longest // 8)
    fs_hz = recordings[0].fs_hz
    spectra = np.zeros((3, length // 2 - 1), dtype=complex)  # force, cross-spectrum, displacement
    for u, y in stretches:
        if len(u) >= length:
            each = (
                welch(u, fs_hz, nperseg=length),
                csd(u, y, fs_hz, nperseg=length),
                welch(y, fs_hz, nperseg=length),
            )
            spectra = spectra + len(u) * np.stack([one[1][1:-1] for one in each])
    omega = 2 * np.pi * np.fft.rfftfreq(length, 1 / fs_hz)[1:-1]
    force, both, motion = spectra
    used = force.real > 1e-4 * force.real.max()
    coherence = np.zeros(len(omega))
    coherence[used] = np.abs(both[used]) ** 2 / (force[used].real * motion[used].real)
    used &= coherence > LEAST_COHERENCE
    response, omega = both[used] / force[used], omega[used]
    weight = np.sqrt(coherence[used] / np.maximum(1 - coherence[used], 1e-3))
    columns = np.stack([response, 1j * omega * response, -(omega**2) * response], 1) * weight[:, None]
    scale = np.abs(columns).max(0) if len(omega) > 3 else np.ones(3)
    matrix, right = np.concatenate([columns.real, columns.imag]) / scale, np.append(weight, 0 * weight)
    k, c, m = np.linalg.lstsq(matrix, right)[0] / scale
    if not (m > 0 and k > 0):
        raise RecordingError(
            f"{recordings[0].name}: found no mode in the frequency response from force to displacement, "
            "expected one within the frequency range of the force"
        )
    return float(m), float(c if c > 0 else 0.02 * math.sqrt(k * m)), float(k)


def _half_widths(problem: OutputError, found: OptimizeResult) -> dict[str, float | None]:
    """Return half-widths of 95 % intervals, from the Jacobian at the solution and the rms error."""
    theta, samples = found.x, len(found.fun)
    values = np.array(problem.parameters(theta))
    steps = DIFFERENCE * np.eye(len(theta))
    moved = np.stack([np.array(problem.parameters(theta + step)) - values for step in steps], 1) / DIFFERENCE
    slopes = problem.slopes(theta)
    scale = np.maximum(np.linalg.norm(slopes, axis=0), np.finfo(float).tiny)
    _, strength, axes = np.linalg.svd(slopes / scale, full_matrices=False)
    # A direction that the recording does not determine keeps a wide interval.
    strength = np.maximum(strength, np.finfo(float).eps * strength[0])
    root = moved @ (axes.T / strength / scale[:, None])
    variance = 2 * float(found.cost) / max(samples - len(theta) - 1, 1)
    half = INTERVAL * np.sqrt(variance * np.square(root).sum(1))
    widths: dict[str, float | None] = dict(zip(BoucWenParameters._fields, half.tolist(), strict=True))
    if problem.exponent is not None:
        widths["exponent"] = None
    return widths


def _check(recordings: Sequence[Recording], counted: Sequence[np.ndarray]) -> None:
    first = recordings[0]
    for one, counts in zip(recordings, counted, strict=True):
        if one.fs_hz != first.fs_hz:
            raise RecordingError(
                f"{one.name}: found {one.fs_hz:g} Hz, expected {first.fs_hz:g} Hz as in {first.name}"
            )
        longest = max((part.stop - part.start for part in _runs(counts)), default=0)
        if longest < 2 * LEAST_SAMPLES:
            raise RecordingError(
                f"{one.name}: found {longest} consecutive samples to fit, expected "
                f"at least {2 * LEAST_SAMPLES}"
            )
        if not (np.ptp(one.u) > 0 and np.ptp(one.y) > 0):
            raise RecordingError(f"{one.name}: found a constant force or displacement, expected both to vary")


def _runs(counts: np.ndarray) -> list[slice]:
    """Return the stretches in which all samples count."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], counts, [False]]).astype(int)))
    return [slice(int(first), int(last)) for first, last in edges.reshape(-1, 2)]


def _head(recording: Recording, counts: np.ndarray) -> tuple[Recording, np.ndarray]:
    last = max(SEARCHED, int(np.argmax(counts)) + 2 * LEAST_SAMPLES)
    short = replace(recording, t=recording.t[:last], u=recording.u[:last], y=recording.y[:last], aux={})
    return replace(short, simulated=None), counts[:last]
