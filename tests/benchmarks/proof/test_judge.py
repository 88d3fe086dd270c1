"""Every rule by which an answer is graded, each with one that passes and one that fails."""

import math

import numpy as np
import pytest
from concealed.judging.grade import grade
from concealed.names import GROUPS, NAMES, STATIC
from hand_made import FS_HZ, NOISE_UM, answer, effect, labels, named, value


class TestNames:
    def test_the_truth_by_its_name_is_exact_and_another_is_wrong(self):
        right = grade(labels(effect("creep")), answer(named("creep")))
        assert (right.exact, right.found, right.wrong) == (["creep"], ["creep"], [])
        other = grade(labels(effect("creep")), answer(named("hum")))
        assert (other.exact, other.found, other.wrong) == ([], [], ["hum"])

    @pytest.mark.parametrize("group", [sorted(g) for g in GROUPS])
    def test_a_name_of_the_group_is_right_but_not_exact(self, group):
        for name in group[1:]:
            graded = grade(labels(effect(group[0])), answer(named(name)))
            assert (graded.found, graded.exact, graded.wrong) == ([group[0]], [], [])

    def test_the_groups_are_those_that_are_published(self):
        assert set(GROUPS) == {
            STATIC,
            frozenset({"amplifier_lag", "sensor_lag"}),
            frozenset({"resonance", "second_mode"}),
        }
        assert len(STATIC) == 5 and len(NAMES) == 25 and frozenset().union(*GROUPS) < set(NAMES)

    def test_the_truth_among_five_names_is_right_and_among_six_is_wrong(self):
        few = ["hum", "creep", "ageing", "delay"]
        right = grade(labels(effect("creep")), answer(named("leakage", *few)))
        assert right.found == ["creep"] and not right.exact and not right.wrong
        many = grade(labels(effect("creep")), answer(named("leakage", *few, "backlash")))
        assert not many.found and many.wrong == ["leakage"]

    def test_the_exact_name_is_right_whatever_its_alternatives(self):
        many = ["hum", "leakage", "ageing", "delay", "backlash"]
        assert grade(labels(effect("creep")), answer(named("creep", *many))).exact == ["creep"]

    def test_a_name_repeated_among_its_own_alternatives_counts_once(self):
        group = ["leakage", "hum", "creep", "ageing", "delay"]
        assert grade(labels(effect("creep")), answer(named("leakage", *group))).found == ["creep"]

    def test_each_truth_takes_one_name_and_a_second_one_is_wrong(self):
        graded = grade(labels(effect("creep")), answer(named("creep"), named("creep")))
        assert graded.found == ["creep"] and graded.wrong == ["creep"]
        by_group = grade(
            labels(effect("sensor_lag")), answer(named("amplifier_lag"), named("delay", "sensor_lag"))
        )
        assert by_group.found == ["sensor_lag"] and by_group.wrong == ["delay"]

    def test_the_exact_name_is_taken_before_one_of_the_group_and_that_before_an_alternative(self):
        lag = labels(effect("sensor_lag"))
        exact = grade(lag, answer(named("delay", "sensor_lag"), named("amplifier_lag"), named("sensor_lag")))
        assert exact.exact == ["sensor_lag"] and exact.wrong == ["delay", "amplifier_lag"]
        group = grade(lag, answer(named("delay", "sensor_lag"), named("amplifier_lag")))
        assert group.wrong == ["delay"]

    def test_two_truths_need_two_names(self):
        two = labels(effect("creep"), effect("hum"))
        assert grade(two, answer(named("creep", "hum"))).found == ["creep"]
        both = grade(two, answer(named("creep"), named("hum")))
        assert sorted(both.found) == ["creep", "hum"]
        assert [one["right"] for one in both.stated] == [True, True]

    def test_the_name_of_an_effect_outside_the_list_is_wrong(self):
        outside = grade(labels(effect("echo", listed=False)), answer(named("echo")))
        assert (outside.truth, outside.found, outside.wrong) == ([], [], ["echo"])

    def test_a_label_without_a_form_has_none(self):
        bare = {key: value for key, value in effect("creep").items() if key != "form"}
        assert grade(labels(bare), answer(named("creep"))).forms == {}


class TestTolerance:
    def test_what_the_label_tolerates_is_neither_right_nor_wrong(self):
        mode = labels(effect("duffing_mode", listed=False), tolerated=["resonance"])
        graded = grade(mode, answer(named("resonance"), named("creep")))
        assert (graded.tolerated, graded.wrong, graded.found) == (["resonance"], ["creep"], [])
        assert [s["right"] for s in graded.stated] == [None, False]

    def test_a_tolerated_truth_is_right_and_not_merely_tolerated(self):
        shape = labels(effect("hysteresis_operator"), tolerated=["hysteresis_operator"], family="preisach")
        assert grade(shape, answer(named("hysteresis_operator"))).exact == ["hysteresis_operator"]

    def test_a_second_static_name_is_excused_over_plays_where_a_static_effect_is_true(self):
        curve = effect("input_nonlinearity")
        both = answer(named("input_nonlinearity"), named("hysteresis_operator"))
        assert grade(labels(curve), both).tolerated == ["hysteresis_operator"]
        assert grade(labels(curve, family="preisach"), both).wrong == ["hysteresis_operator"]
        assert grade(labels(effect("creep")), answer(named("hysteresis_operator"))).wrong == [
            "hysteresis_operator"
        ]
        assert grade(labels(curve), answer(named("input_nonlinearity"), named("creep"))).wrong == ["creep"]

    @pytest.mark.parametrize(("ticks", "excused"), [(1.0, True), (1.5, True), (1.6, False), (3.0, False)])
    def test_the_hold_of_a_reading_before_the_write_may_be_called_a_delay(self, ticks, excused):
        said = answer(named("delay", delay=value(1e3 * ticks / FS_HZ, "ms")))
        assert (grade(labels(timing="before_write"), said).tolerated == ["delay"]) is excused
        assert grade(labels(), said).wrong == ["delay"]
        beside = answer(named("delay", delay=value(1e3 * ticks / FS_HZ, "ms"), gain=value(9.0, "1")))
        assert (grade(labels(timing="before_write"), beside).tolerated == ["delay"]) is excused

    def test_nothing_but_a_delay_is_excused_by_the_hold(self):
        said = answer(named("creep", tau_1_s=value(1 / FS_HZ, "s")))
        assert grade(labels(timing="before_write"), said).wrong == ["creep"]

    def test_a_delay_without_a_size_is_not_excused(self):
        assert grade(labels(timing="before_write"), answer(named("delay"))).wrong == ["delay"]


class TestContract:
    def test_a_tool_that_fails_names_nothing_and_has_failed(self):
        graded = grade(labels(effect("creep")), None)
        assert graded.failed and graded.verdict == "failed" and not graded.named and not graded.found

    @pytest.mark.parametrize(
        "bad",
        [
            [],
            {"verdict": "perhaps", "effects": []},
            {"effects": []},
            {"verdict": "explained", "effects": ["creep"]},
            {"verdict": "explained", "effects": [{"name": 3}]},
            answer(named("creep", probability=1.2)),
            answer(named("creep", probability=-0.1)),
            answer(named("creep", probability=math.nan)),
            answer(named("creep", probability="high")),
            answer(named("creep") | {"alternatives": "hum"}),
            answer(named("creep") | {"parameters": [1.0]}),
            answer(named("creep") | {"parameters": {"tau_s": 1.0}}),
            {"verdict": "explained", "effects": {"name": "creep"}},
            {"verdict": "explained", "effects": {}},
            {"verdict": "explained", "effects": [], "fit": 0.1},
            answer(named("creep") | {"share": "most"}),
        ],
    )
    def test_an_answer_that_breaks_the_contract_is_no_answer(self, bad):
        graded = grade(labels(effect("creep")), bad)
        assert graded.failed and not graded.found and not graded.wrong

    @pytest.mark.parametrize("probability", [0, 0.0, 1.0, None])
    def test_probabilities_from_zero_to_one_or_none_are_an_answer(self, probability):
        assert not grade(labels(effect("creep")), answer(named("creep", probability=probability))).failed


class TestParameters:
    def rows(self, said: dict, truth: dict | None = None) -> list[dict]:
        lag = effect("amplifier_lag", parameters=truth or {"cutoff_hz": value(100.0, "Hz")})
        return grade(labels(lag), answer(named("amplifier_lag", **said))).parameters

    def test_by_name_and_by_the_only_one_of_the_unit(self):
        assert self.rows({"cutoff_hz": value(110.0, "Hz")})[0]["relative_error"] == pytest.approx(0.1)
        assert self.rows({"bandwidth": value(0.11, "kHz")})[0]["relative_error"] == pytest.approx(0.1)
        two = {"first": value(110.0, "Hz"), "second": value(300.0, "Hz")}
        assert "relative_error" not in self.rows(two)[0]
        assert "relative_error" not in self.rows({"cutoff_hz": value(110.0, "s")})[0]
        both = {"first_hz": value(100.0, "Hz"), "second_hz": value(200.0, "Hz")}
        assert all("relative_error" not in row for row in self.rows({"other_hz": value(100.0, "Hz")}, both))
        assert "relative_error" not in self.rows({}, both)[0]

    def test_a_true_zero_and_what_is_no_number_have_no_relative_error(self):
        assert "relative_error" not in self.rows({"x": value(1.0, "V")}, {"x": value(0.0, "V")})[0]
        assert (
            "relative_error"
            not in self.rows({"x": {"value": "large", "unit": "V"}}, {"x": value(1.0, "V")})[0]
        )

    def test_numbers_without_a_unit_are_compared_by_name_only(self):
        truth = {"gain": value(2.0, "1")}
        assert self.rows({"gain": value(2.0, "1")}, truth)[0]["relative_error"] == 0
        assert "relative_error" not in self.rows({"ratio": value(2.0, "1")}, truth)[0]

    @pytest.mark.parametrize(
        ("true", "unit", "number"),
        [
            *(("s", *pair) for pair in (("s", 2.0), ("ms", 2e3), ("us", 2e6), ("µs", 2e6))),
            *(("Hz", *pair) for pair in (("Hz", 2.0), ("kHz", 2e-3), ("mHz", 2e3), ("rad/s", 4 * math.pi))),
            *(("um", *pair) for pair in (("um", 2.0), ("µm", 2.0), ("μm", 2.0), ("nm", 2e3))),
            *(("V/s", *pair) for pair in (("V/s", 2.0), ("V/ms", 2e-3))),
            *(("um/V", *pair) for pair in (("um/V", 2.0), ("µm/V", 2.0), ("μm/V", 2.0), ("nm/V", 2e3))),
            *(("1/um", unit, 2.0) for unit in ("1/um", "1/µm", "µm⁻¹")),
            *(("1/um^2", unit, 2.0) for unit in ("1/um^2", "1/µm²", "1/µm^2")),
            *(("1/V", unit, 2.0) for unit in ("1/V",)),
            *(("1/V^2", unit, 2.0) for unit in ("1/V^2", "1/V²")),
            *(("1", *pair) for pair in (("1", 2.0), ("", 2.0), ("%", 200.0), ("per decade", 2.0))),
            ("A", "A", 2.0),
        ],
    )
    def test_units_are_brought_to_one(self, true, unit, number):
        (row,) = self.rows({"x": value(number, unit)}, {"x": value(2.0, true)})
        assert row["relative_error"] == pytest.approx(0, abs=1e-12)

    def test_an_interval_covers_or_it_does_not(self):
        inside, outside = ([90.0, 105.0], [90.0, 100.0], [100.0, 105.0]), ([101.0, 105.0], [90.0, 99.0])
        for interval, covered in [*((i, True) for i in inside), *((i, False) for i in outside)]:
            assert self.rows({"cutoff_hz": value(98.0, "Hz", interval)})[0]["covered"] is covered
        for none in (None, [90.0, None], [90.0], [90.0, math.inf], "wide"):
            assert self.rows({"cutoff_hz": value(98.0, "Hz") | {"interval_90": none}})[0]["covered"] is None
        for ends, covered in (([0.09, 0.105], True), ([0.101, 0.105], False), ([0.09, 0.099], False)):
            assert self.rows({"cutoff_hz": value(0.098, "kHz", ends)})[0]["covered"] is covered

    def test_a_second_value_that_is_as_true_is_accepted(self):
        truth = {"delay_s": value(0.002, "s") | {"or": 0.003}}
        said = {"delay_s": value(0.003, "s", [0.0029, 0.0031])}
        assert (
            self.rows(said, truth)[0]["relative_error"] == 0 and self.rows(said, truth)[0]["covered"] is True
        )
        assert self.rows(said, {"delay_s": value(0.002, "s")})[0]["covered"] is False

    def test_only_the_exact_name_is_compared(self):
        lag = effect("amplifier_lag", parameters={"cutoff_hz": value(100.0, "Hz")})
        said = answer(named("sensor_lag", cutoff_hz=value(100.0, "Hz")))
        assert grade(labels(lag), said).parameters == []


class TestHeldOut:
    def ratio(self, predicted: np.ndarray, *effects: dict) -> float | None:
        measured = np.full(100, 0.5)
        found = grade(labels(*effects), answer(), predicted_um=predicted + 0.5, measured_um=measured)
        return found.heldout_over_noise

    def test_the_residual_is_in_units_of_the_noise(self):
        assert self.ratio(np.full(100, 3 * NOISE_UM)) == pytest.approx(3.0)

    def test_half_a_step_of_a_true_quantisation_is_noise_too(self):
        lsb = effect("quantization", parameters={"lsb_um": value(math.sqrt(12) * NOISE_UM, "um")})
        assert self.ratio(np.full(100, 3 * NOISE_UM), lsb) == pytest.approx(3 / math.sqrt(2))
        assert self.ratio(np.full(100, 3 * NOISE_UM), effect("creep"), lsb) == pytest.approx(3 / math.sqrt(2))

    def test_a_prediction_of_another_length_or_without_a_number_is_useless(self):
        assert self.ratio(np.zeros(99)) == self.ratio(np.full(100, np.nan)) == 1e9

    def test_without_a_prediction_or_a_measurement_there_is_no_residual(self):
        some = np.zeros(9)
        for given in ({"predicted_um": some}, {"measured_um": some}, {}):
            assert grade(labels(), answer(), **given).heldout_over_noise is None
        failed = grade(labels(), None, predicted_um=some, measured_um=some)
        assert failed.heldout_over_noise is None

    def test_the_gain_is_that_of_the_augmented_stage_over_the_retuned(self):
        assert grade(labels(), answer(heldout_um=(2.0, 0.5))).heldout_gain == pytest.approx(0.75)
        some, none = {"heldout_rms_um": 1.0}, {"heldout_rms_um": 0.0}
        for fit in ({}, {"retuned": 1.0}, {"retuned": none, "augmented": none}, {"retuned": some}):
            assert grade(labels(), {"verdict": "explained", "fit": fit}).heldout_gain is None
        assert grade(labels(), answer(heldout_um=(1.0, math.nan))).heldout_gain is None
