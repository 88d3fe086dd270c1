"""What shows each effect, and what distinguishes two effects of a pair, in plain sentences.

Where no recording of voltage and displacement can decide, the sentence names the other measurement that can,
and the voltage to play meanwhile.
"""

from dataclasses import dataclass

from torchpi.diagnosis import deciding_excitation as play
from torchpi.diagnosis.deciding_excitation import Movement


@dataclass(frozen=True)
class Decision:
    """The excitation that would decide, and why."""

    why: str
    movement: Movement


STAIRS = "On a staircase up and down through the same levels,"

SHOWS: dict[str, Decision] = {
    "voltage_saturation": Decision(
        "Saturation does nothing below its level and clips the peaks above it; slow triangles of growing "
        "amplitude show the level.",
        play.GROWING,
    ),
    "slew_limit": Decision(
        "A slew limit leaves a small sine unchanged and turns a large one of the same frequency into a "
        "triangle.",
        play.SINES,
    ),
    "amplifier_lag": Decision(
        "A lag lowers the gain at high frequencies, in the same proportion at any amplitude.", play.MULTISINES
    ),
    "delay": Decision(
        "A delay shifts the phase in proportion to the frequency and leaves the gain unchanged. Voltage "
        "and displacement alone show neither where in the chain it lies nor whether half a sample of it "
        "comes from the converter's hold: for that, record the amplifier's output with a probe as "
        "aux_amplifier_v.",
        play.MULTISINES,
    ),
    "input_nonlinearity": Decision(
        "A curved input characteristic causes distortion on even lines and on the odd lines left "
        "unexcited, and this distortion remains when everything is slow.",
        play.SLOW_MULTISINES,
    ),
    "hysteresis_asymmetry": Decision(
        "An asymmetric hysteresis causes even lines that shrink more slowly with the amplitude than those "
        "of a curved characteristic.",
        play.SLOW_MULTISINES,
    ),
    "incongruent_loops": Decision(
        "If loops are incongruent, minor loops of one size have a different shape at each bias.", play.LOOPS
    ),
    "hysteresis_operator": Decision(
        "A different kind of hysteresis shows in minor loops at several biases and in nested minor loops.",
        play.LOOPS,
    ),
    "rate_dependent_hysteresis": Decision(
        "A rate-dependent hysteresis widens the loop with the rate: the same triangle is traced at three "
        "rates.",
        play.RATES,
    ),
    "creep": Decision(
        "Logarithmic creep continues by the same amount in every decade of time, whereas a single "
        "relaxation ends: a hold over three decades tells them apart.",
        play.LONG_HOLD,
    ),
    "leakage": Decision(
        "With leakage, the displacement decays to zero during a hold; with creep, it continues in the "
        "direction of the last move: both show in long holds after steps up and down.",
        play.LONG_STAIRS,
    ),
    "ageing": Decision(
        "If the gain ages with travel, strokes are smaller after many repetitions and do not recover "
        "during a rest.",
        play.TWICE,
    ),
    "cross_coupling": Decision(
        "The contribution of another axis shows if both axes move independently: move the other axis "
        "while this plays, and record its voltage in a column aux_other_v.",
        play.MULTISINES,
    ),
    "load_change": Decision(
        "A load changes the static gain, and so does the gain of the actuator or the sensor: recordings "
        "with a single load cannot tell them apart. Play this once with the load and once without it, or "
        "with another known load; the load shifts the resonance, a gain does not.",
        play.MULTISINES,
    ),
    "resonance": Decision(
        "A resonance raises the gain towards one frequency and rings at it at any amplitude.", play.MULTISINES
    ),
    "second_mode": Decision(
        "A second mode is a narrow peak beside a dip: resolving it takes closely spaced lines over the "
        "whole band.",
        play.MULTISINES,
    ),
    "backlash": Decision(
        "Backlash loses the same distance at every reversal, however small the stroke.", play.SMALL_REVERSALS
    ),
    "stiction": Decision(
        "With stiction, small reversals cause no motion at all, and larger ones end in a jump.",
        play.SMALL_REVERSALS,
    ),
    "thermal_drift": Decision(
        "Drift depends on time alone, on the way up as on the way down. A temperature recorded as "
        "aux_temperature would show what causes it.",
        play.LONG_STAIRS,
    ),
    "sensor_nonlinearity": Decision(
        "A curved sensor characteristic causes harmonics of the displacement that remain when everything "
        "is slow.",
        play.SLOW_MULTISINES,
    ),
    "sensor_lag": Decision(
        "A slow sensor lowers the gain at high frequencies, in the same proportion at any amplitude.",
        play.MULTISINES,
    ),
    "hum": Decision("Hum is the same at rest as in motion.", play.REST),
    "quantization": Decision("A very slow ramp shows the individual steps of a converter.", play.REST),
}
"""For each effect, what shows it most clearly, whatever it is mistaken for."""

SPLITS: dict[frozenset[str], Decision] = {
    frozenset(("amplifier_lag", "delay")): Decision(
        "A lag and a delay shift the phase alike; only the lag lowers the gain, and only at high "
        "frequencies.",
        play.MULTISINES,
    ),
    frozenset(("sensor_lag", "delay")): Decision(
        "A slow sensor and a delay shift the phase alike; only the sensor lowers the gain, at high "
        "frequencies.",
        play.MULTISINES,
    ),
    frozenset(("amplifier_lag", "sensor_lag")): Decision(
        "Voltage and displacement alone cannot tell a slow amplifier from a slow sensor: both have the "
        "same effect on the signal. Put a voltage probe at the amplifier's output, record it as "
        "aux_amplifier_v while this plays, and see whether that voltage already lags.",
        play.MULTISINES,
    ),
    frozenset(("amplifier_lag", "slew_limit")): Decision(
        "At one frequency, a lag attenuates every amplitude by the same factor; a slew limit leaves a "
        "small amplitude unchanged and attenuates a large one strongly.",
        play.SINES,
    ),
    frozenset(("slew_limit", "voltage_saturation")): Decision(
        "Saturation clips slow triangles as well; a slew limit leaves all slow motion unchanged.",
        play.GROWING,
    ),
    frozenset(("voltage_saturation", "input_nonlinearity")): Decision(
        "Below its level, saturation does nothing; a curved input characteristic bends the small "
        "triangles too.",
        play.GROWING,
    ),
    frozenset(("rate_dependent_hysteresis", "delay")): Decision(
        "A delay shifts the whole displacement by the same time; the effect of a rate-dependent "
        "hysteresis changes with the amplitude and after reversals, and it causes distortion on unexcited "
        "lines.",
        play.MULTISINES,
    ),
    frozenset(("rate_dependent_hysteresis", "amplifier_lag")): Decision(
        "A lag is linear: it has the same gain and phase at both amplitudes and causes nothing on "
        "unexcited lines. A rate-dependent hysteresis is not linear.",
        play.MULTISINES,
    ),
    frozenset(("rate_dependent_hysteresis", "creep")): Decision(
        "Creep continues while the voltage is held; a rate-dependent hysteresis then stands still.",
        play.LONG_HOLD,
    ),
    frozenset(("creep", "thermal_drift")): Decision(
        f"{STAIRS} creep changes direction with the last step, whereas drift depends on time alone.",
        play.LONG_STAIRS,
    ),
    frozenset(("creep", "leakage")): Decision(
        f"{STAIRS} creep continues in the direction of the last step, whereas leakage always decays "
        "towards zero.",
        play.LONG_STAIRS,
    ),
    frozenset(("leakage", "thermal_drift")): Decision(
        f"{STAIRS} leakage is faster the higher the level, whereas drift depends on time alone. In a short "
        "or one-way recording they look the same.",
        play.LONG_STAIRS,
    ),
    frozenset(("ageing", "thermal_drift")): Decision(
        "Drift shifts the zero and continues during a rest; ageing makes the strokes smaller and stops "
        "during a rest.",
        play.TWICE,
    ),
    frozenset(("ageing", "creep")): Decision(
        "Creep recovers during a rest, a loss of gain does not.",
        play.TWICE,
    ),
    frozenset(("hysteresis_asymmetry", "sensor_nonlinearity")): Decision(
        "A curved sensor characteristic causes even lines that depend on the displacement alone and grow "
        "with the square of the amplitude; those of an asymmetric hysteresis grow more slowly and differ "
        "between the way up and the way down.",
        play.SLOW_MULTISINES,
    ),
    frozenset(("hysteresis_asymmetry", "input_nonlinearity")): Decision(
        "A curved input characteristic causes even lines that grow with the square of the amplitude; "
        "those of an asymmetric hysteresis grow more slowly.",
        play.SLOW_MULTISINES,
    ),
    frozenset(("sensor_nonlinearity", "input_nonlinearity")): Decision(
        "Voltage and displacement alone can hardly tell a curved sensor from a curved input "
        "characteristic. Measure the displacement with a second sensor, such as an interferometer, in a "
        "column aux_reference_um while this plays: if one sensor plotted against the other gives a curve, "
        "the sensor is nonlinear.",
        play.SLOW_MULTISINES,
    ),
    frozenset(("backlash", "hysteresis_asymmetry")): Decision(
        "Backlash loses the same distance at every reversal of a triangle, small or large; the effect of "
        "an asymmetry shrinks with the triangle.",
        play.GROWING,
    ),
    frozenset(("backlash", "stiction")): Decision(
        "With backlash, the stage lags by the same distance until the next reversal; with stiction, it "
        "breaks free with a jump and is then where it should be. Slow, small reversals show the "
        "difference.",
        play.SMALL_REVERSALS,
    ),
    frozenset(("resonance", "second_mode")): Decision(
        "Whether there are one or two modes shows only with closely spaced lines around both peaks.",
        play.MULTISINES,
    ),
    frozenset(("resonance", "load_change")): SHOWS["load_change"],
    frozenset(("resonance", "amplifier_lag")): Decision(
        "Both shift the phase; towards its peak, a resonance raises the gain, whereas a lag lowers it.",
        play.MULTISINES,
    ),
    frozenset(("resonance", "delay")): Decision(
        "Both shift the phase; towards its peak, a resonance raises the gain, whereas a delay leaves it "
        "unchanged.",
        play.MULTISINES,
    ),
    frozenset(("hum", "cross_coupling")): Decision(
        "Hold this axis still, and the other one too: hum remains. Record the other axis's voltage as "
        "aux_other_v.",
        play.REST,
    ),
    frozenset(("quantization", "thermal_drift")): Decision(
        "Drift continues during a rest; on a very slow ramp, a converter shows its steps.", play.REST
    ),
    frozenset(("incongruent_loops", "input_nonlinearity")): Decision(
        "With a curved input characteristic, the slope of a minor loop changes with its bias; with "
        "incongruent loops, its shape does.",
        play.LOOPS,
    ),
    frozenset(("incongruent_loops", "sensor_nonlinearity")): Decision(
        "With a curved sensor characteristic, the slope of a minor loop changes with its bias; with "
        "incongruent loops, its shape does.",
        play.LOOPS,
    ),
}
"""For pairs of candidates: what distinguishes them, or what else would have to be measured."""

CONFIRM = Decision(
    "No question is open. An independent recording, with other phases, would confirm the model on data "
    "that no fit has seen.",
    play.MULTISINES,
)
DETERMINE = Decision(
    "Minor loops at several biases, and nested ones, determine the hysteresis for other motions.",
    play.LOOPS,
)
"""For a hysteresis that the recordings do not determine."""
NAMELESS = Decision(
    "Part of the residual has no name yet. Distortion on even lines would show that it is asymmetric, "
    "distortion on unexcited odd lines that it is a symmetric nonlinearity, and differences between "
    "periods that it does not follow the voltage at all.",
    play.SLOW_MULTISINES,
)
