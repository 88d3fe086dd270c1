"""The paragraph: the verdict in plain English, each effect stated as firmly as its probability allows."""

import re
from dataclasses import replace

import numpy as np
import pytest

from torchpi.diagnosis.decide import Decision
from torchpi.diagnosis.diagnosis import (
    AcrossRecordings,
    Errors,
    NamedEffect,
    NextRecording,
    Parameter,
    Verdict,
)
from torchpi.diagnosis.noise import Noise
from torchpi.diagnosis.posterior import HALF, Believed
from torchpi.diagnosis.say import paragraph, percent, readable, sentence, spoken_parameter

ERRORS = [Errors(one, one, one) for one in (0.05, 0.04, 0.0042)]
NOISE = Noise(0.004, np.full(5, 1.6e-5), 2e3, "holds of the voltage")
NEXT = NextRecording("No question is open.", "none")


def lag(probability: float, alternatives: tuple[str, ...] = ()) -> NamedEffect:
    numbers = (Parameter("cutoff_hz", 412.0, "Hz", (398.0, 427.0)),)
    return NamedEffect(
        "amplifier_lag", "amplifier", alternatives, probability, numbers, 0.71, "v̇ = …", "phase", ()
    )


def decided(
    verdict: Verdict,
    *effects: NamedEffect,
    still_open: tuple[Believed, ...] = (),
    unexplained: float = 0.2,
    joint: float = 0.0,
) -> Decision:
    return Decision(verdict, effects, still_open, unexplained, joint, 0.004)


@pytest.mark.parametrize(
    ("probability", "words"),
    [
        (0.97, "The simulation lacks"),
        (0.7, "The simulation probably lacks"),
        (0.4, "The simulation may lack"),
    ],
)
def test_the_verb_follows_the_probability(probability: float, words: str) -> None:
    text = sentence(lag(probability, ("sensor_lag", "delay")))
    assert text.startswith(f"{words} an amplifier lag (cutoff 412 Hz): 71 % of the squared")
    assert f"probability {100 * probability:.0f} %" in text
    assert text.endswith("these recordings cannot distinguish it from a sensor lag or a delay.")


def test_the_form_of_an_effect_is_stated() -> None:
    assert "amplifier lag (two poles; cutoff 412 Hz)" in sentence(replace(lag(0.9), form="two poles"))


def test_a_parameter_with_an_integer_value_is_stated() -> None:
    """The neutral value 1 stands in for a recording that has not been made yet."""
    ageing = replace(lag(0.9), parameters=(Parameter("exponent", 1, "", (0.4, 1.3)),))
    assert "(exponent 1)" in sentence(ageing)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (0.25, "0.25 s"),
        (0.1, "0.1 s"),
        (0.0123, "12.3 ms"),
        (-2e-3, "-2 ms"),
        (1.443e-4, "144.3 µs"),
        (0.0, "0 s"),
    ],
)
def test_short_times_are_stated_in_ms_or_us(value: float, words: str) -> None:
    found = readable(Parameter("delay_s", value, "s", (value / 2, value * 2)))
    assert f"{found.value:.4g} {found.unit}" == words
    times = {"s": 1.0, "ms": 1e3, "µs": 1e6}[found.unit]
    assert found.interval_90 == pytest.approx((times * value / 2, times * value * 2))
    assert readable(found) is found or found.unit == "s"


def test_other_units_and_words_are_stated_as_they_are() -> None:
    for one in (Parameter("cutoff_hz", 0.01, "Hz", None), Parameter("family", "duhem", "s", None)):
        assert readable(one) is one
    late = replace(lag(0.9), parameters=(Parameter("delay_s", 1.443e-4, "s", None),))
    assert "(delay 144.3 µs)" in sentence(late)


def test_a_hysteresis_operator_is_called_by_the_names_of_its_authors() -> None:
    family = (Parameter("family", "bouc_wen", "", None),)
    named = replace(lag(0.9), name="hysteresis_operator", block="actuator", parameters=family)
    assert "lacks another hysteresis operator in the actuator (Bouc–Wen): 71 %" in sentence(named)


def test_errors_across_recordings_are_stated_in_place_of_the_unexplained_share() -> None:
    each = (AcrossRecordings("slow", 0.004, 0.004), AcrossRecordings("fast", 0.04, 0.005))
    only_here = replace(decided("partly_explained", lag(0.9)), carries_over=False)
    text = paragraph(only_here, ERRORS, NOISE, NEXT, across=each)
    assert "predicts fast with an error of 40 nm, against 5 nm when fitted to all." in text
    assert "remains unexplained" not in text
    text = paragraph(only_here, ERRORS, NOISE, NEXT, untested=("loops between two levels",))
    assert "This was tested only on loops between two levels" in text and "remains unexplained" not in text
    text = paragraph(decided("explained", lag(0.9)), ERRORS, NOISE, NEXT, across=each[:1])
    assert "the hysteresis predicts each recording equally well." in text
    each = (*each[:1], AcrossRecordings("fast", 0.007, 0.005))
    text = paragraph(decided("explained", lag(0.9)), ERRORS, NOISE, NEXT, across=each)
    assert "the hysteresis predicts each recording with an error at most 1.4 times as large." in text


def test_the_uncertainty_of_another_motion_is_stated_where_a_hysteresis_is_named() -> None:
    text = paragraph(decided("explained", lag(0.9)), ERRORS, NOISE, NEXT, another_um=0.0712)
    assert "leave the prediction of the hysteresis uncertain by 71.2 nm rms." in text
    assert "uncertain" not in paragraph(decided("explained", lag(0.9)), ERRORS, NOISE, NEXT)


def test_the_share_that_effects_explain_only_jointly_is_stated() -> None:
    creep = replace(lag(0.9), name="creep")
    text = paragraph(decided("explained", lag(0.9), creep, joint=0.45), ERRORS, NOISE, NEXT)
    assert "45 % is explained by amplifier lag and creep together and cannot be attributed to any" in text
    text = paragraph(decided("explained", lag(0.9), joint=0.45), ERRORS, NOISE, NEXT)
    assert "45 % is explained by several effects together and cannot be attributed to any single one." in text
    assert "together" not in paragraph(decided("explained", lag(0.9)), ERRORS, NOISE, NEXT)


def test_noise_that_was_not_measured_is_stated_as_such() -> None:
    known = paragraph(decided("explained", lag(0.9)), ERRORS, NOISE, NEXT)
    unknown = paragraph(decided("explained", lag(0.9)), ERRORS, None, NEXT)
    assert "the noise, measured in holds of the voltage, is 4 nm" in known
    assert "the noise was not measured" in unknown and "4 nm" not in unknown


def test_an_error_that_does_not_fall_is_not_reported_as_falling() -> None:
    better = paragraph(decided("explained", lag(0.9)), ERRORS, NOISE, NEXT)
    worse = paragraph(decided("explained", lag(0.9)), [ERRORS[0], ERRORS[1], ERRORS[0]], NOISE, NEXT)
    assert "With this included, the error falls to 4.2 nm." in better
    assert (
        "On the held-out samples this brings no improvement: the error is 50 nm with it." in worse
        and "falls" not in worse
    )


def test_a_random_walk_is_said_to_be_unpredictable_where_it_does_not_help() -> None:
    walks = replace(lag(0.9), form="random walk")
    text = paragraph(decided("partly_explained", walks), [ERRORS[0], ERRORS[1], ERRORS[0]], NOISE, NEXT)
    assert "the error is 50 nm with it, as no stage can predict a random walk." in text


def test_the_report_states_size_and_location_of_the_remaining_residual() -> None:
    text = paragraph(decided("partly_explained", lag(0.9)), ERRORS, NOISE, NEXT, ("620 Hz", "the first 2 s"))
    assert "20 % of the squared residual remains unexplained" in text
    assert "The remaining residual stands out in 620 Hz; the first 2 s." in text
    unknown = paragraph(decided("partly_explained", lag(0.9), unexplained=0.0), ERRORS, None, NEXT)
    assert "Part of the squared residual remains unexplained" in unknown


def test_an_unnamed_remainder_is_mentioned_only_if_it_helps() -> None:
    helped = paragraph(decided("unexplained"), ERRORS, NOISE, NEXT)
    useless = paragraph(decided("unexplained"), [ERRORS[0], ERRORS[1], ERRORS[1]], NOISE, NEXT)
    assert "an unnamed remainder lowers the error to 4.2 nm" in helped
    assert "remainder" not in useless and "well enough to be named." in useless


def test_the_verdict_explained_states_the_limits_of_its_test() -> None:
    alike = ("voltages from 1 to 3 V", "loops between two levels", "strokes at one rate")
    closed = paragraph(decided("explained", lag(0.9)), ERRORS, NOISE, NEXT, (), alike)
    assert "tested only on voltages from 1 to 3 V, loops between two levels and strokes at one rate" in closed
    for verdict, phrases in (("explained", ()), ("partly_explained", alike)):
        assert "tested" not in paragraph(decided(verdict, lag(0.9)), ERRORS, NOISE, NEXT, (), phrases)


def test_an_effect_too_uncertain_to_be_named_is_mentioned() -> None:
    doubtful = Believed("sensor_lag", 0.31, (), 1e-4, (), HALF)
    text = paragraph(decided("unexplained", still_open=(doubtful,)), ERRORS, NOISE, NEXT)
    assert "There may also be a sensor lag: with a probability of 31 % it is too uncertain to be" in text


def test_the_paragraph_has_no_identifiers() -> None:
    text = paragraph(decided("partly_explained", lag(0.6, ("sensor_lag",))), ERRORS, NOISE, NEXT)
    assert not re.search(r"[a-z]_[a-z]", text)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("frequency_hz[axis 1]", "frequency [axis 1]"),
        ("coupling_um_per_v", "coupling"),
        ("c2_per_v", "c2"),
        ("c3_per_v2", "c3"),
        ("rate_v_per_s", "rate"),
        ("weight_s_per_v", "weight"),
        ("lsb_um", "lsb"),
        ("per_decade", "per decade"),
        ("damping_ratio", "damping ratio"),
        ("loss_per_mm", "loss"),
    ],
)
def test_parameters_are_named_without_units(name: str, words: str) -> None:
    assert spoken_parameter(name) == words


def test_a_percentage_is_never_rounded_to_certainty() -> None:
    assert [percent(x) for x in (1.0, 0.999, 0.99, 0.004, 0.0)] == [
        "100 %",
        "over 99 %",
        "99 %",
        "0.4 %",
        "0 %",
    ]
