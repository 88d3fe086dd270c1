"""Identify one stage of several axes from recordings at several amplitudes.

The modes come from the best linear approximation at the middle amplitude. Then the feedback gets elements
that sense by how much each actuator's elongation exceeds its voltage. First their weights are fitted, finally
all parameters. Dead zones make loops asymmetric, relaxing plays make them lag, a stiffness that follows the
mean amplitude moves the resonances without distortion, and rate-sensing elements damp them.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from torchpi.errors import ConfigError, RecordingError, is_number, is_positive, is_whole
from torchpi.identification.multi_axis.fit import Period, PeriodicFit
from torchpi.identification.multi_axis.linear import (
    best_linear_approximation,
    fitted_poles,
    modes_of,
    windowed,
)
from torchpi.operators.modal_feedback import Shapes, parameter_shapes
from torchpi.recordings.multi_axis import MultiAxisRecording, usable
from torchpi.stage.multi_axis import MultiAxisStage

RELATIVE_ERROR = 0.0125
"""Share of the largest rms of a recording: an error of this size counts as much as noise."""
NOISE = 1.5
"""Factor on the noise of the mean period, in its weight."""
FAINT, SLOW, SILENT = 0.05, 1.5, 0.1
"""Size of a motion near rest, as a share of the smallest recording's; size of a slow motion, as a multiple of
the largest rms; weight of the error in either."""
BEYOND, LOOSE = 1.25, 1.0
"""The largest amplitude at which a stage must not ring, as a multiple of the largest recording's, and the
weight, there and between amplitudes, of an error as large as the motion."""
STEEP = 8.0
"""Slope of the moves between two held voltages, as a multiple of that of a sine of the same period."""
PIECE = 8192
"""Maximum number of samples in a piece of a record without periods."""
ALIKE = 1.25
"""Amplitudes within this ratio count as one level."""
QUASI_STATIC = 0.02
"""Share of the spectral lines, the lowest, whose mean response is the static gain."""
FIRST_WEIGHT = 0.01
AHEAD = 8
"""Number of future samples of the voltage on which a displacement depends."""
LINEAR_STEPS, WEIGHT_STEPS, MODE_STEPS, STEPS = 25, 4, 4, 8
ZONES = (0.0, 1.5, 4.0, -1.5, -4.0)
PLAYS = ((0.1, 1.0), (0.2, 1.0), (0.4, 1.0), (0.3, 30.0), (1.0, 30.0))
INPUT_PLAYS = ((0.1, 1.0), (0.3, 1.0), (1.0, 1.0), (0.1, 30.0), (0.3, 30.0), (1.0, 30.0))
"""Thresholds, in units of the rms of the largest input at the highest amplitude, and rates, Hz."""
SHARP = 0.2
"""Damping ratio below which a mode contributes to the rate of the elastic part."""
CROSSOVER = (0.1, 0.3)
"""Widths, in units of the rms slope of that input."""


@dataclass(frozen=True)
class Physics:
    """Effects that are put into the feedback of the modes and at the inputs.

    Args:
        zones: Thresholds of the elements' dead zones: asymmetry without memory.
        plays: Thresholds and rates of their relaxing plays: hysteresis that the motion drives.
        follows_amplitude: Whether stiffness and damping follow the mean amplitude.
        input_plays: Thresholds and rates of the plays of the voltages.
        crossover: Whether amplifiers have crossover distortion, if their bandwidth is known.
        feedback: Whether there are elements in the feedback at all.
    """

    zones: tuple[float, ...] = ZONES
    plays: tuple[tuple[float, float], ...] = PLAYS
    follows_amplitude: bool = True
    input_plays: tuple[tuple[float, float], ...] = INPUT_PLAYS
    crossover: bool = True
    feedback: bool = True


ALL = Physics()


@dataclass(frozen=True)
class MultiAxisOptions:
    """Options of the identification, and its time limit.

    Args:
        modes: Number of pairs of states, including those that represent dynamics beyond the band.
        extra_elements: Number of nonlinear elements in addition to those of each input.
        times_s: Averaging times of the amplitude that the stiffness follows, s.
        amplifier_hz: Bandwidth of the amplifiers, Hz; if given, their crossover distortion is identified.
        seconds: Time limit of the fit; a step that has begun is finished.
        seed: Seed of the initial directions of the extra elements.
    """

    modes: int = 24
    extra_elements: int = 2
    times_s: tuple[float, ...] = (0.3, 0.02)
    amplifier_hz: float | None = None
    seconds: float = 480.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (("modes", 1), ("extra_elements", 0), ("seed", 0)):
            value = getattr(self, name)
            if not is_whole(value) or value < least:
                raise ConfigError(f"{name}: found {value!r}, expected a whole number, {least} or more")
        if not is_number(self.seconds) or not self.seconds >= 0:
            raise ConfigError(f"seconds: found {self.seconds!r}, expected a number that is not negative")
        hertz = self.amplifier_hz
        if hertz is not None and not is_positive(hertz):
            raise ConfigError(f"amplifier_hz: found {hertz!r}, expected a positive number")
        if not all(map(is_positive, self.times_s)):
            raise ConfigError(f"times_s: found {list(self.times_s)!r}, expected positive numbers")


def identify(
    recordings: Sequence[MultiAxisRecording],
    options: MultiAxisOptions | None = None,
    log: Callable[[str], None] = lambda text: None,
) -> MultiAxisStage:
    """Identify one stage for all recordings.

    Periodic recordings have whole periods in steady state. Others take the time-domain path: they are cut
    into pieces, each simulated from rest through the preceding one, so the first piece is not fitted.

    Args:
        recordings: At one amplitude or several, with at least as many realisations as inputs at one of them.
        options: Options of the identification, and its time limit.
        log: Called with each line of progress.

    Raises:
        RecordingError: The recordings are not of one stage, or do not show what each input does.
    """
    options = options or MultiAxisOptions()
    recordings = usable(recordings)
    started = time.monotonic()
    levels = by_amplitude(recordings)
    inputs = recordings[0].u.shape[1]
    full = [level for level in levels if len(level) >= inputs]
    if not full:
        raise RecordingError(
            f"{recordings[0].name}: found {max(map(len, levels))} realisations at one amplitude, expected "
            f"at least {inputs}, one for each input"
        )
    middle = full[len(full) // 2]
    linear, z, response = linear_stage(middle, options.modes)
    fit = PeriodicFit(linear, periods(middle))
    fit.in_matrix = len(middle)
    names = list(linear.arrays())
    cost = fit.descend(names, LINEAR_STEPS)
    log(f"linear, {options.modes} modes: weighted error {np.sqrt(cost):.3g}")
    gain = static_gain(z, response)
    stage = with_elements(linear, gain, recordings, options)
    weights = ["weights", "play_weights", "seen", "direct", "ahead"]

    def goes_on(cost: float) -> bool:
        passed = time.monotonic() - started
        log(f"{passed:.0f} s: weighted error {np.sqrt(cost):.4g}")
        return passed < options.seconds

    every = periods([one for level in levels for one in level])
    others = [*other_amplitudes(levels), *holds(recordings, gain)]
    fit = PeriodicFit(stage, every, guards(recordings, gain), others)
    fit.descend(weights, WEIGHT_STEPS)
    fit.descend([*weights, "poles", "drive"], MODE_STEPS)
    fit.descend(names, STEPS, tolerance=0.0, goes_on=goes_on)
    fit.descend_bent(goes_on)
    return stage


def by_amplitude(recordings: Sequence[MultiAxisRecording]) -> list[list[MultiAxisRecording]]:
    """Group the recordings by amplitude, the lowest first."""
    levels: list[list[MultiAxisRecording]] = []
    for one in sorted(recordings, key=lambda recording: float(recording.u.std())):
        if levels and one.u.std() < ALIKE * levels[-1][0].u.std():
            levels[-1].append(one)
        else:
            levels.append([one])
    return levels


def periods(recordings: Sequence[MultiAxisRecording]) -> list[Period]:
    """Return the mean period of each, or the pieces of one without periods; noisy ones weigh less.

    A nonlinearity outside the model class leaves most at the largest amplitude, which is to weigh most.
    """
    largest, found = max(float(one.y.std()) for one in recordings), []
    for one in recordings:
        mean_u, mean_y, noise = one.period
        weight = 1.0 / float(np.hypot(RELATIVE_ERROR * largest, NOISE * noise))
        if one.periods > 1:
            found.append(Period(mean_u, mean_y, weight))
            continue
        pieces = max(2, -(-len(one.u) // PIECE))
        length = len(one.u) // pieces
        each = one.u[: length * pieces].reshape(pieces, length, -1)
        seen = one.y[: length * pieces].reshape(pieces, length, -1)
        found += [Period(each[k], seen[k] - seen[k].mean(0), weight, each[k - 1]) for k in range(1, pieces)]
    return found


def guards(recordings: Sequence[MultiAxisRecording], gain: np.ndarray) -> list[Period]:
    """Return artificial periods, at rest and in slow motion, through which a stage must not ring."""
    return [silence(by_amplitude(recordings)[0][0]), slow_motion(recordings, gain)]


def slow_motion(recordings: Sequence[MultiAxisRecording], gain: np.ndarray) -> Period:
    """Return slow sines of all inputs, which the displacements follow apart from the hysteresis.

    A stiffness or damping that follows the voltage averages out in recordings of fast voltages; if it is held
    for long, the same voltage may drive a mode without bounds.
    """
    largest = max(recordings, key=lambda one: float(one.u.std()))
    mean = largest.period[0]
    samples = len(mean) if largest.periods > 1 else min(len(mean), PIECE)
    cycles = np.arange(1, mean.shape[1] + 1)
    u = SLOW * float(largest.u.std()) * np.sin(2 * np.pi * np.outer(np.arange(samples) / samples, cycles))
    y = u @ gain
    return Period(u, y - y.mean(0), SILENT / (RELATIVE_ERROR * float(y.std())))


def holds(recordings: Sequence[MultiAxisRecording], gain: np.ndarray) -> list[Period]:
    """Return each input in turn held at both ends of its recorded range, and moved between them.

    Recordings of fast voltages only pass the ends, so a stiffness that follows the mean voltage is not known
    for one that stays there, and such a voltage may drive a mode without bounds.
    """
    samples = min(min(len(one.period[0]) for one in recordings), PIECE)
    wave = np.clip(STEEP * np.sin(2 * np.pi * np.arange(samples) / samples), -1, 1)
    low = np.min([one.u.min(0) for one in recordings], axis=0)
    high = np.max([one.u.max(0) for one in recordings], axis=0)
    found = []
    for i in range(len(gain)):
        u = np.tile((low + high) / 2, (samples, 1))
        u[:, i] += (high - low)[i] / 2 * wave
        y = u @ gain
        found.append(Period(u, y - y.mean(0), LOOSE / float(y.std())))
    return found


def other_amplitudes(levels: Sequence[Sequence[MultiAxisRecording]]) -> list[Period]:
    """Return a recording of each level, scaled to the geometric mean with the next, or the last beyond it.

    Feedback that is stable at the recorded amplitudes may be unstable at others. The displacements there are
    not known: they are scaled as if the stage were linear, and their errors weigh only where it rings.
    """
    sizes = [float(level[0].u.std()) for level in levels]
    found = []
    for level, size, larger in zip(levels, sizes, [*sizes[1:], BEYOND**2 * sizes[-1]], strict=True):
        one, factor = periods(level[:1])[0], float(np.sqrt(larger / size))
        before = None if one.before is None else factor * one.before
        y = factor * one.y
        found.append(Period(factor * one.u, y, LOOSE / float(y.std()), before))
    return found


def silence(recording: MultiAxisRecording) -> Period:
    """Return a period at rest after a small motion, in which a stage must not ring by itself.

    Feedback that is stable at the recorded amplitudes may be unstable near rest, where nothing was recorded.
    """
    u, y, _ = recording.period
    before = FAINT * u
    before[len(u) // 2 :] = 0
    scale = RELATIVE_ERROR * FAINT * float(y.std())
    return Period(np.zeros_like(u), np.zeros_like(y), SILENT / scale, before)


def linear_stage(
    level: Sequence[MultiAxisRecording], modes: int, ahead: int = AHEAD
) -> tuple[MultiAxisStage, np.ndarray, np.ndarray]:
    """Fit modes alone to the realisations of one amplitude; return the stage, z and the fitted response."""
    z, response = response_of(level)
    found = modes_of(z, response, fitted_poles(z, response, modes))
    shapes = Shapes(
        response.shape[1], response.shape[2], modes, elements=0, functions=1, input_plays=0, ahead=ahead
    )
    arrays = {name: found.get(name, np.zeros(shape)) for name, shape in parameter_shapes(shapes).items()}
    return MultiAxisStage(level[0].fs_hz, arrays), z, response


def response_of(level: Sequence[MultiAxisRecording]) -> tuple[np.ndarray, np.ndarray]:
    """Return the best linear approximation at one amplitude: z of its lines, and (lines, inputs, outputs)."""
    if all(one.periods > 1 for one in level):
        means = [one.period for one in level]
        return best_linear_approximation([u for u, _, _ in means], [y for _, y, _ in means])
    return best_linear_approximation(*windowed([one.u for one in level], [one.y for one in level]))


def static_gain(z: np.ndarray, response: np.ndarray) -> np.ndarray:
    """Return the static gain, (inputs, outputs), µm/V, from the lowest lines."""
    lowest = np.argsort(np.angle(z))[: max(int(QUASI_STATIC * len(z)), 4)]
    gain: np.ndarray = response[lowest].mean(0).real
    return gain


def with_elements(
    linear: MultiAxisStage,
    gain: np.ndarray,
    recordings: Sequence[MultiAxisRecording],
    options: MultiAxisOptions,
    physics: Physics = ALL,
) -> MultiAxisStage:
    """Return the stage with elements at the inputs, and more in random directions, all with almost no force.

    One element of each input senses the elastic part of its actuator's elongation and represents hysteresis
    and stiffness; a second one senses the rate of that part and represents damping.
    """
    old = linear.arrays()
    inputs = linear.inputs
    scale = max(float(one.u.std()) for one in recordings)
    extra = options.extra_elements if physics.feedback else 0
    elements = 2 * inputs + extra if physics.feedback else 0
    times_s = options.times_s if physics.follows_amplitude else ()
    at_means = len(physics.zones) + len(physics.plays)
    widths = crossover_widths(recordings) if options.amplifier_hz and physics.crossover else []
    excess = len(physics.input_plays) + 2 * len(widths)
    functions = at_means + len(times_s) + 1
    shapes = linear.shapes._replace(elements=elements, functions=functions, input_plays=excess)
    arrays = {name: np.zeros(shape) for name, shape in parameter_shapes(shapes).items()}
    arrays |= {name: old[name].copy() for name in ("poles", "drive", "seen", "direct", "ahead")}
    if physics.feedback:
        put_elements(arrays, gain, options.seed, extra, at_means)
    return MultiAxisStage(
        linear.sample_rate_hz,
        arrays,
        input_thresholds_v=[scale * r for r, _ in physics.input_plays],
        input_rates_hz=[rate for _, rate in physics.input_plays],
        dead_zones=[scale * r for r in physics.zones],
        thresholds=[scale * r for r, _ in physics.plays],
        rates_hz=[rate for _, rate in physics.plays],
        times_s=times_s,
        crossover_v_per_s=widths,
        amplifier_hz=options.amplifier_hz if options.amplifier_hz and widths else np.inf,
    )


def put_elements(
    arrays: dict[str, np.ndarray], gain: np.ndarray, seed: int, extra: int, at_means: int
) -> None:
    """Fill in what elements sense, where they act, and their initial strength; modes and gain are given."""
    modes, inputs = arrays["drive"].shape[0], arrays["drive"].shape[2]
    elements = 2 * inputs + extra
    random = np.random.default_rng(seed)
    mixed = np.concatenate([np.eye(inputs), random.standard_normal((extra, inputs))])
    back = np.linalg.pinv(gain)  # (outputs, inputs), V/µm
    # Elongation, in volts, less the voltage: the elastic part, which follows the stress.
    elastic = np.einsum("ni,oi,omc->nmc", mixed, back, arrays["seen"])
    first, rest = slice(0, inputs), slice(2 * inputs, None)
    rates = slice(inputs, 2 * inputs)
    arrays["sensed"][first], arrays["sensed"][rest] = elastic[:inputs], elastic[inputs:]
    arrays["sensed"][rates] = rate_of(elastic[:inputs], arrays["poles"])
    through = mixed @ (back.T @ arrays["direct"] - np.eye(inputs))
    arrays["through"][first], arrays["through"][rest] = through[:inputs], through[inputs:]
    directions = np.concatenate([mixed[:inputs], mixed])
    arrays["force"] = np.einsum("mci,ni->mcn", arrays["drive"], directions).reshape(modes, 2, elements)
    arrays["weights"][first, at_means] = FIRST_WEIGHT
    arrays["weights"][rates, at_means] = FIRST_WEIGHT / 10
    arrays["weights"][rest, 0] = FIRST_WEIGHT / 2
    arrays["weights"][rest, at_means] = FIRST_WEIGHT / 10


def rate_of(seen: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """Return what senses the rate of what `seen` (…, modes, 2) senses, scaled to the same size."""
    slopes = np.log(poles @ np.array([1, 1j]))
    sharp = np.abs(slopes.real) < SHARP * np.abs(slopes)
    turned = (seen @ np.array([1, -1j])) * np.where(sharp, slopes, 0)
    size = np.sqrt(np.square(np.abs(turned)).sum() / np.square(seen).sum())
    return np.stack([turned.real, -turned.imag], -1) / max(float(size), 1e-12)


def crossover_widths(recordings: Sequence[MultiAxisRecording]) -> list[float]:
    """Return the widths, V/s, from the largest rms slope of an input."""
    slopes = []
    for one in recordings:
        u = one.period[0]
        lines = 2j * np.pi * np.fft.rfftfreq(len(u), 1 / one.fs_hz)[:, None]
        slopes.append(float(np.fft.irfft(lines * np.fft.rfft(u, axis=0), len(u), axis=0).std()))
    return [share * max(slopes) for share in CROSSOVER]
