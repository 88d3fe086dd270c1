"""Diagnose what a simulation of several axes lacks, by amplitude, and identify a stage that has it.

The simulation is a linear stage; by default one is identified from the recordings. Possible effects are added
and fitted one after another, each with as many steps; realisations that no fit has seen decide.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from torchpi.errors import RecordingError, StageError
from torchpi.identification.multi_axis.fit import PeriodicFit
from torchpi.identification.multi_axis.identify import (
    LINEAR_STEPS,
    MODE_STEPS,
    NOISE,
    RELATIVE_ERROR,
    WEIGHT_STEPS,
    MultiAxisOptions,
    Physics,
    by_amplitude,
    crossover_widths,
    guards,
    identify,
    linear_stage,
    periods,
    response_of,
    static_gain,
    with_elements,
)
from torchpi.identification.multi_axis.properties import Loop, loop_of
from torchpi.operators.modal_feedback import parameter_shapes
from torchpi.recordings.multi_axis import MultiAxisRecording, usable
from torchpi.stage.multi_axis import MultiAxisStage

CANDIDATES = {
    "asymmetry without memory": Physics(plays=(), follows_amplitude=False, input_plays=(), crossover=False),
    "hysteresis of the voltages alone": Physics(
        zones=(), plays=(), follows_amplitude=False, crossover=False, feedback=False
    ),
    "hysteresis in the actuators": Physics(zones=(), crossover=False),
}
CROSSOVER = "hysteresis in the actuators, crossover distortion of the amplifiers"
"""Tried if hysteresis in the actuators was the best candidate."""
AMPLIFIER = 0.28
"""Bandwidth of the amplifiers if none is given, as a share of the sample rate."""
LINEAR, HYSTERESIS = "other numbers of the linear model", "hysteresis in the actuators"
CANDIDATE_STEPS = 3
"""Steps of a candidate over all parameters."""
MOVED = 0.003
"""Relative shift of a resonance from which the summary mentions it."""
GAINED = 0.1
"""Least relative reduction of the held-out error, against the linear model, for an effect to be named."""


@dataclass(frozen=True, eq=False)
class Level:
    """Results at one amplitude.

    Attributes:
        input_rms_v: Rms of the voltages.
        motion_um: Rms of the displacements in the realisation that is held out.
        noise_um: Noise of its mean period; 0 if there is only one period.
        errors_um: Held-out errors by name: the simulation, each candidate, and the final stage.
        resonance_hz: Frequency of the largest response at this amplitude; None without a response.
        loop_widths: Loop width of each actuator under a sine whose amplitude is this rms, as a share of its
            stroke; None if the stage has no bounded response.
    """

    input_rms_v: float
    motion_um: float
    noise_um: float
    errors_um: dict[str, float]
    resonance_hz: float | None
    loop_widths: list[float | None]


@dataclass(frozen=True, eq=False)
class AxesDiagnosis:
    """Result of the diagnosis.

    Attributes:
        levels: Results by amplitude, the lowest first.
        named: The missing effect; None if no effect lowers the held-out error enough.
        summary: The answer in a few sentences.
        stage: The stage that has this effect.
        loops: Loop of each actuator at the highest amplitude.
        heldout: Names of the realisations that decided.
    """

    levels: list[Level]
    named: str | None
    summary: str
    stage: MultiAxisStage
    loops: list[Loop]
    heldout: list[str]

    def as_json(self) -> dict[str, Any]:
        """Return plain numbers by name."""
        return {
            "named": self.named,
            "summary": self.summary,
            "heldout": self.heldout,
            "levels": [
                {**vars(level), "errors_um": {name: _finite(e) for name, e in level.errors_um.items()}}
                for level in self.levels
            ],
        }


SIMULATION, STAGE = "the simulation", "the augmented stage"


def diagnose_axes(
    recordings: Sequence[MultiAxisRecording],
    simulation: MultiAxisStage | None = None,
    options: MultiAxisOptions | None = None,
    log: Callable[[str], None] = lambda text: None,
) -> AxesDiagnosis:
    """Name the effect that the simulation lacks, and identify a stage that has it.

    Args:
        recordings: Recordings at one amplitude or several, with more realisations than inputs at one of them.
        simulation: A stage of as many inputs and outputs; None identifies a linear one.
        options: Options of the stage that is identified at the end; crossover distortion is tried even if no
            bandwidth is given.
        log: Called with each line of progress.

    Raises:
        RecordingError: Recordings are not of one stage, too few to hold one out, or do not match the
            simulation.
    """
    options = options or MultiAxisOptions()
    recordings = usable(recordings)
    fitted, heldout = split(recordings)
    first = fitted[0]
    options = replace(options, amplifier_hz=options.amplifier_hz or AMPLIFIER * first.fs_hz)
    levels = by_amplitude(fitted)
    middle = [level for level in levels if len(level) >= first.u.shape[1]]
    basis = middle[len(middle) // 2]
    if simulation is None:
        simulation, _, _ = linear_stage(basis, options.modes)
        fit = PeriodicFit(simulation, periods(basis))
        fit.in_matrix = len(basis)
        fit.descend(list(simulation.arrays()), LINEAR_STEPS)
        log(f"the simulation: a linear stage of {options.modes} modes, fitted to {len(basis)} recordings")
    check_of(simulation, first)
    errors = {SIMULATION: rms_of(simulation, heldout)}
    log(f"{SIMULATION}: held-out error {_listed(errors[SIMULATION])} µm")
    linear, gain = linear_part(simulation), static_gain(*response_of(basis))
    PeriodicFit(linear, periods(fitted)).descend(list(linear.arrays()), LINEAR_STEPS)
    errors[LINEAR] = rms_of(linear, heldout)
    log(f"{LINEAR}: held-out error {_listed(errors[LINEAR])} µm")
    stages = {}
    for name, physics in CANDIDATES.items():
        stages[name] = candidate(with_elements(linear, gain, fitted, options, physics), fitted, gain)
        errors[name] = rms_of(stages[name], heldout)
        log(f"{name}: held-out error {_listed(errors[name])} µm")
    if min(CANDIDATES, key=lambda name: sum(np.log(errors[name]))) == HYSTERESIS:
        stage = candidate(with_crossover(stages[HYSTERESIS], fitted, options), fitted, gain)
        errors[CROSSOVER] = rms_of(stage, heldout)
        log(f"{CROSSOVER}: held-out error {_listed(errors[CROSSOVER])} µm")
    mean = {name: float(np.exp(np.mean(np.log(each)))) for name, each in errors.items()}
    best = min((name for name in mean if name not in (SIMULATION, LINEAR)), key=lambda name: mean[name])
    enough = all(
        left <= max(RELATIVE_ERROR * float(one.y.std()), NOISE * one.period[2])
        for left, one in zip(errors[LINEAR], heldout, strict=True)
    )
    named, final = None if enough or mean[best] >= (1 - GAINED) * mean[LINEAR] else best, linear
    if named is not None:
        amplifier_hz = options.amplifier_hz if named == CROSSOVER else None
        final = identify(fitted, replace(options, modes=linear.shapes.modes, amplifier_hz=amplifier_hz), log)
    errors[STAGE] = rms_of(final, heldout)
    log(f"{STAGE}: held-out error {_listed(errors[STAGE])} µm")
    found = []
    for k, (one, level) in enumerate(zip(heldout, by_amplitude(recordings), strict=True)):
        drawn = loops_of(final, float(one.u.std()))
        widths = [None if loop is None else loop.width for loop in drawn]
        found.append(
            Level(
                float(one.u.std()),
                float(one.y.std()),
                one.period[2],
                {name: each[k] for name, each in errors.items()},
                resonance(level),
                widths,
            )
        )
    loops = [loop for loop in loops_of(final, found[-1].input_rms_v) if loop is not None]
    return AxesDiagnosis(found, named, summary_of(found, named), final, loops, [one.name for one in heldout])


def split(
    recordings: Sequence[MultiAxisRecording],
) -> tuple[list[MultiAxisRecording], list[MultiAxisRecording]]:
    """Return the recordings to fit, and the last realisation of each amplitude, which is held out.

    Raises:
        RecordingError: An amplitude has only one realisation, or none has more realisations than inputs.
    """
    levels, inputs = by_amplitude(recordings), recordings[0].u.shape[1]
    most = max(map(len, levels))
    if most <= inputs:
        raise RecordingError(
            f"{recordings[0].name}: found {most} realisations at one amplitude, expected at least "
            f"{inputs + 1}: one for each input, and one that is held out"
        )
    for level in levels:
        if len(level) < 2:
            raise RecordingError(
                f"{level[0].name}: found one realisation at {level[0].u.std():.3g} V rms, expected at least "
                "two: one is held out"
            )
    order = [id(one) for one in recordings]
    heldout = [max(level, key=lambda one: order.index(id(one))) for level in levels]
    return [one for one in recordings if one not in heldout], heldout


def check_of(simulation: MultiAxisStage, first: MultiAxisRecording) -> None:
    """Check that a simulation matches the stage of the recordings.

    Raises:
        RecordingError: The number of inputs or outputs, or the sample rate, differs.
    """
    if found := simulation.mismatch(first.u.shape[1], first.y.shape[1], first.fs_hz):
        raise RecordingError(f"{first.name}: {found} the simulation")


def linear_part(stage: MultiAxisStage) -> MultiAxisStage:
    """Return a stage with only the modes of this one."""
    shapes = stage.shapes._replace(elements=0, functions=1, input_plays=0)
    arrays = {name: np.zeros(shape) for name, shape in parameter_shapes(shapes).items()}
    arrays |= {name: stage.arrays()[name] for name in ("poles", "drive", "seen", "direct", "ahead")}
    return MultiAxisStage(stage.sample_rate_hz, arrays, offset_um=stage.offset().tolist())


def with_crossover(
    stage: MultiAxisStage, fitted: Sequence[MultiAxisRecording], options: MultiAxisOptions
) -> MultiAxisStage:
    """Return the stage with crossover distortion of its amplifiers, initially with zero weights."""
    arrays, widths = stage.arrays(), crossover_widths(fitted)
    more = np.zeros((stage.inputs, 2 * len(widths)))
    arrays["play_weights"] = np.concatenate([arrays["play_weights"], more], 1)
    changed = {"crossover_v_per_s": widths, "amplifier_hz": options.amplifier_hz}
    return MultiAxisStage(**{**stage.plain(), **changed, "parameters": arrays})


def candidate(
    stage: MultiAxisStage, fitted: Sequence[MultiAxisRecording], gain: np.ndarray
) -> MultiAxisStage:
    """Fit the stage for a few steps, and return it."""
    fit = PeriodicFit(stage, periods(fitted), guards(fitted, gain))
    weights = ["weights", "play_weights", "seen", "direct", "ahead"]
    fit.descend(weights, WEIGHT_STEPS)
    fit.descend([*weights, "poles", "drive"], MODE_STEPS)
    fit.descend(list(stage.arrays()), CANDIDATE_STEPS)
    return stage


def rms_of(stage: MultiAxisStage, every: Sequence[MultiAxisRecording]) -> list[float]:
    """Return the rms error of each recording, µm; infinite without a bounded response."""
    found = []
    for one in every:
        errors = PeriodicFit(stage, periods([one])).errors()
        squares = np.inf if errors is None else np.mean([np.square(error).mean() for error in errors])
        found.append(float(np.sqrt(squares)))
    return found


def loops_of(stage: MultiAxisStage, amplitude_v: float) -> list[Loop | None]:
    """Return the loop of each actuator; None if a slow motion has no bounded response."""
    found: list[Loop | None] = []
    for number in range(1, stage.inputs + 1):
        try:
            found.append(loop_of(stage, number, amplitude_v))
        except StageError:
            found.append(None)
    return found


def resonance(level: Sequence[MultiAxisRecording]) -> float | None:
    """Return the frequency of the largest response, Hz; None with fewer realisations than inputs."""
    if len(level) < level[0].u.shape[1]:
        return None
    z, response = response_of(level)
    power = np.square(np.abs(response)).sum((1, 2))
    window = np.hanning(9) / np.hanning(9).sum()
    return float(np.angle(z[np.convolve(power, window, "same").argmax()]) * level[0].fs_hz / (2 * np.pi))


def summary_of(levels: Sequence[Level], named: str | None) -> str:
    """Return the answer in words."""
    first, last = levels[0], levels[-1]
    if named is None:
        return (
            "None of the effects that were tried is missing: the simulation's held-out error of "
            f"{_listed([one.errors_um[SIMULATION] for one in levels])} µm becomes "
            f"{_listed([one.errors_um[LINEAR] for one in levels])} µm with a refitted linear model."
        )
    sentences = [
        f"The simulation leaves out {named}." if "hysteresis" in named else f"The missing effect is {named}."
    ]
    for one in levels:
        sentences.append(
            f"At {one.input_rms_v:.3g} V rms the held-out error falls from {one.errors_um[SIMULATION]:.3g} "
            f"to {one.errors_um[STAGE]:.3g} µm; the best linear model leaves "
            f"{one.errors_um[LINEAR]:.3g} µm, and the noise is {one.noise_um:.2g} µm."
        )
    moved = first.resonance_hz and last.resonance_hz and abs(last.resonance_hz / first.resonance_hz - 1)
    if moved and moved > MOVED:
        sentences.append(
            f"From {first.input_rms_v:.3g} to {last.input_rms_v:.3g} V rms the largest resonance moves from "
            f"{first.resonance_hz:.4g} to {last.resonance_hz:.4g} Hz, which no linear model does."
        )
    if "hysteresis" in named and None not in last.loop_widths:
        widths = " / ".join(f"{100 * one:.2g}" for one in last.loop_widths if one is not None)
        sentences.append(
            f"Slow loops of the actuators are {widths} % of their stroke wide at the highest amplitude."
        )
    return " ".join(sentences)


def _listed(values: Sequence[float]) -> str:
    return " / ".join(f"{value:.3g}" for value in values)


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
