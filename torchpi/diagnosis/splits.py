"""What decides between two effects: for each what shows it, for pairs what splits them, in plain sentences.

Where no recording of voltage and displacement can decide, the sentence names the other measurement, and the
voltage to play meanwhile.
"""

from dataclasses import dataclass

from torchpi.diagnosis import deciding_excitation as play
from torchpi.diagnosis.deciding_excitation import Movement


@dataclass(frozen=True)
class Decision:
    """What would decide, and why."""

    why: str
    movement: Movement


STAIRS = "On stairs up and down over the same levels"

SHOWS: dict[str, Decision] = {
    "voltage_saturation": Decision(
        "Saturation does nothing below its level and cuts flat tops above it; slow triangles that grow "
        "show the level.",
        play.GROWING,
    ),
    "slew_limit": Decision(
        "A slew limit does nothing to a small sine and makes a triangle of a large one of the same "
        "frequency.",
        play.SINES,
    ),
    "amplifier_lag": Decision(
        "A lag lowers the gain at high frequencies, in the same proportion at any amplitude.", play.MULTISINES
    ),
    "delay": Decision(
        "A delay turns the phase in proportion to the frequency and leaves the gain as it is. Where in "
        "the chain it lies, and half a sample of it that the hold of the converter makes, voltage and "
        "displacement cannot tell: for that, record the amplifier's output with a probe as "
        "aux_amplifier_v.",
        play.MULTISINES,
    ),
    "input_nonlinearity": Decision(
        "A curved input makes even lines, and lines left out, that stay when everything is slow.",
        play.SLOW_MULTISINES,
    ),
    "hysteresis_asymmetry": Decision(
        "An asymmetric hysteresis makes even lines that shrink more slowly with the amplitude than a "
        "curved characteristic's.",
        play.SLOW_MULTISINES,
    ),
    "incongruent_loops": Decision(
        "Minor loops of one size are then of another shape at every bias.", play.LOOPS
    ),
    "hysteresis_operator": Decision(
        "Another kind of hysteresis shows in minor loops at several biases and inside one another.",
        play.LOOPS,
    ),
    "rate_dependent_hysteresis": Decision(
        "The loop then widens with the rate: the same triangle is traced at three rates.", play.RATES
    ),
    "creep": Decision(
        "Logarithmic creep goes on by the same amount in every decade of time, a single relaxation ends: "
        "a hold over three decades tells them apart.",
        play.LONG_HOLD,
    ),
    "leakage": Decision(
        "A leak lets a hold decay to zero, a creeping stage goes on the way it moved: both show in long "
        "holds after steps up and down.",
        play.LONG_STAIRS,
    ),
    "ageing": Decision(
        "What ages with travel is smaller after many strokes, and no larger after a rest.", play.TWICE
    ),
    "cross_coupling": Decision(
        "What another axis adds shows while this one plays something independent: record the other axis's "
        "voltage in a column aux_other_v, and move it meanwhile.",
        play.MULTISINES,
    ),
    "load_change": Decision(
        "A load changes the static gain, which a gain of actuator or sensor does as well: no recording of "
        "one load can tell. Play this once with the load and once without it, or with another known one; "
        "the resonance moves with the load and not with a gain.",
        play.MULTISINES,
    ),
    "resonance": Decision(
        "A resonance raises the gain towards one frequency and rings at it at any amplitude.", play.MULTISINES
    ),
    "second_mode": Decision(
        "A second mode is a narrow peak beside a dip: it takes lines close together over the whole band.",
        play.MULTISINES,
    ),
    "backlash": Decision(
        "Backlash loses the same distance at every reversal, however small the stroke.", play.SMALL_REVERSALS
    ),
    "stiction": Decision(
        "With stiction small reversals move nothing at all, and larger ones jump.", play.SMALL_REVERSALS
    ),
    "thermal_drift": Decision(
        "Drift follows the clock, on the way up as on the way down. A temperature recorded as "
        "aux_temperature would settle what causes it.",
        play.LONG_STAIRS,
    ),
    "sensor_nonlinearity": Decision(
        "A curved sensor makes harmonics of the displacement that stay when everything is slow.",
        play.SLOW_MULTISINES,
    ),
    "sensor_lag": Decision(
        "A slow sensor lowers the gain at high frequencies, in the same proportion at any amplitude.",
        play.MULTISINES,
    ),
    "hum": Decision("Hum is the same at rest as in motion.", play.REST),
    "quantization": Decision("A very slow ramp shows the single steps of a converter.", play.REST),
}
"""What shows an effect at its clearest, whatever it is taken for."""

SPLITS: dict[frozenset[str], Decision] = {
    frozenset(("amplifier_lag", "delay")): Decision(
        "A lag and a delay turn the phase alike; only the lag lowers the gain, and only at high frequencies.",
        play.MULTISINES,
    ),
    frozenset(("sensor_lag", "delay")): Decision(
        "A slow sensor and a delay turn the phase alike; only the sensor lowers the gain, at high "
        "frequencies.",
        play.MULTISINES,
    ),
    frozenset(("amplifier_lag", "sensor_lag")): Decision(
        "Voltage and displacement alone cannot tell a slow amplifier from a slow sensor: both do the same "
        "to their path. Put a voltage probe at the amplifier's output, record it as aux_amplifier_v while "
        "this plays, and see whether it already lags.",
        play.MULTISINES,
    ),
    frozenset(("amplifier_lag", "slew_limit")): Decision(
        "At one frequency a lag takes the same share at every amplitude; a slew limit takes nothing from "
        "the small one and much from the large one.",
        play.SINES,
    ),
    frozenset(("slew_limit", "voltage_saturation")): Decision(
        "Saturation cuts the tops of slow triangles as well; a slew limit leaves everything slow alone.",
        play.GROWING,
    ),
    frozenset(("voltage_saturation", "input_nonlinearity")): Decision(
        "Below its level saturation does nothing; a curved input bends the small triangles too.", play.GROWING
    ),
    frozenset(("rate_dependent_hysteresis", "delay")): Decision(
        "A delay shifts all of the displacement by one time; a rate-dependent hysteresis bends with the "
        "amplitude, and after reversals, and lights up lines that were left out.",
        play.MULTISINES,
    ),
    frozenset(("rate_dependent_hysteresis", "amplifier_lag")): Decision(
        "A lag is linear: the same gain and phase at both amplitudes, and nothing on the lines left out. "
        "A rate-dependent hysteresis is not.",
        play.MULTISINES,
    ),
    frozenset(("rate_dependent_hysteresis", "creep")): Decision(
        "Creep goes on while the voltage rests; a hysteresis that follows the rate then stands still.",
        play.LONG_HOLD,
    ),
    frozenset(("creep", "thermal_drift")): Decision(
        f"{STAIRS} creep changes its direction with the last step, drift follows the clock.",
        play.LONG_STAIRS,
    ),
    frozenset(("creep", "leakage")): Decision(
        f"{STAIRS} creep goes on the way of the last step, a leak always towards zero.", play.LONG_STAIRS
    ),
    frozenset(("leakage", "thermal_drift")): Decision(
        f"{STAIRS} a leak takes the more the higher the level, drift follows the clock alone. On a short "
        "or one-way recording they are the same.",
        play.LONG_STAIRS,
    ),
    frozenset(("ageing", "thermal_drift")): Decision(
        "Drift moves the zero and goes on during a rest; ageing makes the strokes smaller, and rests with "
        "them.",
        play.TWICE,
    ),
    frozenset(("ageing", "creep")): Decision(
        "Creep recovers in a rest, a lost gain does not.",
        play.TWICE,
    ),
    frozenset(("hysteresis_asymmetry", "sensor_nonlinearity")): Decision(
        "A curved sensor makes even lines that follow from the displacement alone and grow with the "
        "square of the amplitude; those of an asymmetric hysteresis grow more slowly and differ up and "
        "down.",
        play.SLOW_MULTISINES,
    ),
    frozenset(("hysteresis_asymmetry", "input_nonlinearity")): Decision(
        "A curved input makes even lines that grow with the square of the amplitude; those of an "
        "asymmetric hysteresis grow more slowly.",
        play.SLOW_MULTISINES,
    ),
    frozenset(("sensor_nonlinearity", "input_nonlinearity")): Decision(
        "Voltage and displacement alone hardly tell a curved sensor from a curved input. Measure the "
        "displacement with a second sensor, such as an interferometer, in a column aux_reference_um while "
        "this plays: a curve between the two sensors is the sensor's.",
        play.SLOW_MULTISINES,
    ),
    frozenset(("backlash", "hysteresis_asymmetry")): Decision(
        "Backlash loses the same distance at every turn of a triangle, small or large; an asymmetry "
        "shrinks with the triangle.",
        play.GROWING,
    ),
    frozenset(("backlash", "stiction")): Decision(
        "Backlash leaves a lag behind that stays until the next reversal; with stiction the stage lets go "
        "with a jump and is then where it should be. Slow small reversals show the difference.",
        play.SMALL_REVERSALS,
    ),
    frozenset(("resonance", "second_mode")): Decision(
        "One mode or two shows only where lines lie close together about both peaks.", play.MULTISINES
    ),
    frozenset(("resonance", "load_change")): SHOWS["load_change"],
    frozenset(("resonance", "amplifier_lag")): Decision(
        "Both turn the phase; towards its peak a resonance raises the gain, and a lag lowers it.",
        play.MULTISINES,
    ),
    frozenset(("resonance", "delay")): Decision(
        "Both turn the phase; towards its peak a resonance raises the gain, a delay leaves it as it is.",
        play.MULTISINES,
    ),
    frozenset(("hum", "cross_coupling")): Decision(
        "Rest this axis, and the other one too: hum stays. Record the other axis's voltage as aux_other_v.",
        play.REST,
    ),
    frozenset(("quantization", "thermal_drift")): Decision(
        "In a rest drift goes on; on a very slow ramp a converter shows its steps.", play.REST
    ),
    frozenset(("incongruent_loops", "input_nonlinearity")): Decision(
        "A curved input changes the slope of a minor loop with its bias; incongruent loops change their "
        "shape.",
        play.LOOPS,
    ),
    frozenset(("incongruent_loops", "sensor_nonlinearity")): Decision(
        "A curved sensor changes the slope of a minor loop with its bias; incongruent loops change their "
        "shape.",
        play.LOOPS,
    ),
}
"""By pair of candidates: what splits them, or what would have to be measured besides."""

CONFIRM = Decision(
    "Nothing is open. An independent recording, with other phases, would confirm the model on data that "
    "no fit has seen.",
    play.MULTISINES,
)
DETERMINE = Decision(
    "Minor loops at several biases, and inside one another, determine a hysteresis for other motions.",
    play.LOOPS,
)
"""Where it is not determined by what was recorded."""
NAMELESS = Decision(
    "A part has no name yet. Even lines would say that it is asymmetric, odd lines left out that it is a "
    "symmetric bend, and what differs between the periods that it does not follow the voltage at all.",
    play.SLOW_MULTISINES,
)
