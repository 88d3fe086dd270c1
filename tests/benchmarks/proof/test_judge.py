"""Every rule of the judge, each with an answer that passes and one that fails."""

import math

import numpy as np
import pytest
from concealed.judging.calibration import calibration, reliability
from concealed.judging.grade import grade
from concealed.judging.proportions import share
from concealed.judging.summary import figures, summarise
from concealed.plant.effects import GROUPS, STATIC
from concealed.real.grade import grade_injected

FS_HZ = 1000.0
NOISE_UM = 0.01


def effect(name: str, severity: float = 10.0, **more: object) -> dict:
    return {
        "name": name,
        "listed": True,
        "severity": severity,
        "severity_beyond_plays": severity / 2,
        "parameters": {},
        "form": "a form",
    } | more


def labels(*effects: dict, **more: object) -> dict:
    return {
        "track": "alien",
        "case": "case_0001",
        "fs_hz": FS_HZ,
        "timing": "end_of_hold",
        "family": "pi",
        "noise_rms_um": NOISE_UM,
        "names": [e["name"] for e in effects if e["listed"]],
        "unknown": [e["name"] for e in effects if not e["listed"]],
        "tolerated": [],
        "effects": list(effects),
    } | more


def named(name: str, *alternatives: str, probability: float | None = 0.9, **parameters: dict) -> dict:
    return {
        "name": name,
        "alternatives": list(alternatives),
        "probability": probability,
        "parameters": parameters,
        "share": 1.0,
    }


def answer(*effects: dict, verdict: str = "explained", heldout_um: tuple[float, float] = (1.0, 0.5)) -> dict:
    fit = {key: {"heldout_rms_um": rms} for key, rms in zip(("retuned", "augmented"), heldout_um, strict=True)}
    return {"verdict": verdict, "effects": list(effects), "fit": fit | {"noise_floor_um": None}}


def value(number: float, unit: str, interval: list[float] | None = None) -> dict:
    return {"value": number, "unit": unit} | ({} if interval is None else {"interval_90": interval})


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
        assert len(STATIC) == 5

    def test_the_truth_among_five_names_is_right_and_among_six_is_wrong(self):
        few = ["hum", "creep", "ageing", "delay"]
        right = grade(labels(effect("creep")), answer(named("leakage", *few)))
        assert right.found == ["creep"] and not right.exact and not right.wrong
        many = grade(labels(effect("creep")), answer(named("leakage", *few, "backlash")))
        assert not many.found and many.wrong == ["leakage"]

    def test_a_name_repeated_among_its_own_alternatives_counts_once(self):
        group = ["leakage", "hum", "creep", "ageing", "delay"]
        assert grade(labels(effect("creep")), answer(named("leakage", *group))).found == ["creep"]

    def test_each_truth_takes_one_name_and_a_second_one_is_wrong(self):
        graded = grade(labels(effect("creep")), answer(named("creep"), named("creep")))
        assert graded.found == ["creep"] and graded.wrong == ["creep"]
        by_group = grade(labels(effect("sensor_lag")), answer(named("amplifier_lag"), named("delay", "sensor_lag")))
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
        assert sorted(grade(two, answer(named("creep"), named("hum"))).found) == ["creep", "hum"]


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
        assert grade(labels(effect("creep")), answer(named("hysteresis_operator"))).wrong == ["hysteresis_operator"]
        assert grade(labels(curve), answer(named("input_nonlinearity"), named("creep"))).wrong == ["creep"]

    @pytest.mark.parametrize(("ticks", "excused"), [(1.0, True), (1.5, True), (1.6, False), (3.0, False)])
    def test_the_hold_of_a_reading_before_the_write_may_be_called_a_delay(self, ticks, excused):
        said = answer(named("delay", delay=value(1e3 * ticks / FS_HZ, "ms")))
        assert (grade(labels(timing="before_write"), said).tolerated == ["delay"]) is excused
        assert grade(labels(), said).wrong == ["delay"]

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
        assert "relative_error" not in self.rows({"x": {"value": "large", "unit": "V"}}, {"x": value(1.0, "V")})[0]

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
        for interval, covered in (([90.0, 105.0], True), ([101.0, 105.0], False), ([90.0, 99.0], False)):
            assert self.rows({"cutoff_hz": value(98.0, "Hz", interval)})[0]["covered"] is covered
        for none in (None, [90.0, None], [90.0], [90.0, math.inf], "wide"):
            assert self.rows({"cutoff_hz": value(98.0, "Hz") | {"interval_90": none}})[0]["covered"] is None
        assert self.rows({"cutoff_hz": value(0.098, "kHz", [0.09, 0.105])})[0]["covered"] is True

    def test_a_second_value_that_is_as_true_is_accepted(self):
        truth = {"delay_s": value(0.002, "s") | {"or": 0.003}}
        said = {"delay_s": value(0.003, "s", [0.0029, 0.0031])}
        assert self.rows(said, truth)[0]["relative_error"] == 0 and self.rows(said, truth)[0]["covered"] is True
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
        assert grade(labels(), {"verdict": "explained"}).heldout_gain is None


class TestFigures:
    """Each figure with a case that it counts, one that it counts against, and one that it leaves out."""

    def of(self, key: str, *grades) -> tuple[int, int]:
        figure = figures(grades)[key]
        return figure["count"], figure["of"]

    def test_recall_is_over_truths_of_twice_the_noise_and_more(self):
        found, missed = answer(named("creep")), answer(verdict="unexplained")
        clear, just, faint = (labels(effect("creep", s)) for s in (8.0, 2.0, 1.9))
        grades = [grade(clear, found), grade(just, missed), grade(faint, found)]
        assert self.of("group", *grades) == (1, 2)
        assert self.of("group_faint", *grades) == (1, 1)
        assert self.of("group_faint", grade(labels(effect("creep", 0.7)), found)) == (1, 1)
        assert self.of("group_faint", grade(labels(effect("creep", 0.69)), found)) == (0, 0)

    def test_recall_leaves_out_what_the_excitation_could_not_show(self):
        poor = labels(effect("creep"), adequate=False)
        assert self.of("group", grade(poor, answer(verdict="unexplained"))) == (0, 0)

    def test_exact_names_are_counted_where_the_pair_is_separable(self):
        lag = grade(labels(effect("sensor_lag")), answer(named("amplifier_lag")))
        creep = grade(labels(effect("creep")), answer(named("creep")))
        by_alternative = grade(labels(effect("creep")), answer(named("leakage", "creep")))
        assert self.of("exact", lag, creep, by_alternative) == (1, 2)
        assert self.of("group", lag, creep, by_alternative) == (3, 3)

    def test_precision_is_right_over_right_and_wrong_names(self):
        grades = [
            grade(labels(effect("creep")), answer(named("creep"), named("hum"))),
            grade(labels(tolerated=["resonance"]), answer(named("resonance"))),
            grade(labels(effect("creep")), answer(verdict="unexplained")),
        ]
        assert self.of("precision", *grades) == (1, 2)

    def test_false_alarms_are_wrong_names_where_nothing_is_missing(self):
        silent, loud = answer(verdict="nothing_missing"), answer(named("creep"))
        grades = [grade(labels(), silent), grade(labels(), loud), grade(labels(effect("hum")), loud)]
        assert self.of("false_alarms", *grades) == (1, 2)
        excused = grade(labels(family="preisach", tolerated=sorted(STATIC)), answer(named("hysteresis_operator")))
        assert self.of("false_alarms", excused) == (0, 1)

    def test_a_null_without_an_answer_is_no_proof_of_silence(self):
        assert self.of("false_alarms", grade(labels(), None)) == (0, 0)
        assert self.of("failed", grade(labels(), None), grade(labels(), answer())) == (1, 2)

    def test_foreign_forms_are_counted_apart(self):
        foreign, shared = (labels(effect("creep", foreign=f)) for f in (True, False))
        right, wrong = answer(named("creep")), answer(named("hum"))
        grades = [grade(foreign, right), grade(foreign, wrong), grade(shared, right)]
        assert self.of("foreign", *grades) == (1, 2)
        assert self.of("foreign_wrong", *grades) == (1, 2)
        outside = grade(labels(effect("echo", listed=False, foreign=True)), wrong)
        assert self.of("foreign_wrong", outside) == (0, 0)

    @pytest.mark.parametrize(
        ("said", "counted"),
        [
            (answer(verdict="unexplained"), True),
            (answer(verdict="partly_explained"), True),
            (answer(verdict="explained"), False),
            (answer(verdict="nothing_missing"), False),
            (answer(named("creep"), verdict="unexplained"), False),
            (answer(named("resonance"), verdict="unexplained"), True),
            (None, False),
        ],
    )
    def test_outside_the_list_the_verdict_stays_open_and_nothing_wrong_is_named(self, said, counted):
        mode = labels(effect("duffing_mode", listed=False), tolerated=["resonance"])
        assert self.of("unknown", grade(mode, said)) == (int(counted), 1)
        nothing_wrong = said is not None and all(e["name"] != "creep" for e in said["effects"])
        assert self.of("unknown_right", grade(mode, said)) == (int(nothing_wrong), 1)

    @pytest.mark.parametrize(("gain", "counted"), [(0.02, True), (0.006, True), (0.004, False), (-0.2, False)])
    def test_outside_the_list_the_fit_improves_where_u_determines_the_effect(self, gain, counted):
        said = answer(verdict="unexplained", heldout_um=(1.0, 1.0 - gain))
        mode = effect("duffing_mode", listed=False)
        assert self.of("unknown_improves", grade(labels(mode), said)) == (int(counted), 1)
        by_itself = effect("glitches", listed=False, foreseeable=False)
        assert self.of("unknown_improves", grade(labels(by_itself), said)) == (0, 0)

    def test_two_at_once_need_the_exact_set_and_three_give_a_mean_f1(self):
        two, three = labels(effect("creep"), effect("hum")), labels(*map(effect, ("creep", "hum", "delay")))
        both, one = [named("creep"), named("hum")], [named("creep")]
        grades = [grade(two, answer(*said)) for said in (both, one, [*both, named("ageing")])]
        assert [self.of("pairs", g) for g in grades] == [(1, 1), (0, 1), (0, 1)]
        assert self.of("pairs", grade(three, answer(*both)), grade(two, None)) == (0, 1)
        assert figures([grade(three, answer(*both))])["triples_f1"] == pytest.approx(0.8)
        assert figures([grade(three, answer(named("ageing"), *one))])["triples_f1"] == pytest.approx(0.4)
        assert figures(grades)["triples_f1"] is None

    def test_intervals_and_errors_are_counted_from_twice_the_noise_on(self):
        def with_interval(severity: float, interval: list[float]) -> object:
            lag = effect("creep", severity, parameters={"tau_s": value(1.0, "s")})
            return grade(labels(lag), answer(named("creep", tau_s=value(1.2, "s", interval))))

        grades = [with_interval(5.0, [0.9, 1.3]), with_interval(2.0, [1.1, 1.3]), with_interval(1.9, [0.9, 1.3])]
        assert self.of("intervals", *grades) == (1, 2)
        assert figures(grades)["parameter_error"] == pytest.approx(0.2)
        assert figures(grades[2:])["parameter_error"] is None
        lag = effect("creep", 5.0, parameters={"tau_s": value(1.0, "s"), "share": value(1.0, "1")})
        bare = grade(labels(lag), answer(named("creep", tau_s=value(1.1, "s"))))
        assert self.of("intervals", bare) == (0, 0) and figures([bare])["parameter_error"] == pytest.approx(0.1)
        assert figures([grades[1]])["parameter_error"] == pytest.approx(0.2)

    def test_held_out_residuals_are_counted_under_a_closed_verdict(self):
        def ratio(times: float, verdict: str) -> object:
            predicted = np.full(50, times * NOISE_UM)
            return grade(labels(), answer(verdict=verdict), predicted_um=predicted, measured_um=np.zeros(50))

        grades = [ratio(1.4, "explained"), ratio(1.6, "nothing_missing"), ratio(2.1, "explained")]
        grades += [ratio(9.0, "unexplained"), grade(labels(), answer())]
        assert self.of("heldout_close", *grades) == (1, 3)
        assert self.of("closed_far", *grades) == (1, 3)
        assert figures(grades)["heldout"] == pytest.approx(1.6)

    def test_seconds_are_the_median(self):
        assert figures([grade(labels(), answer(), diagnose_s=s) for s in (1.0, 2.0, 9.0)])["seconds"] == 2.0


class TestSummary:
    def test_crime_is_apart_from_all_that_is_added_up(self):
        crime = grade(labels(effect("creep"), track="crime"), answer(named("creep")))
        proof = grade(labels(effect("creep")), answer(verdict="unexplained"))
        summary = summarise([crime, proof])
        assert summary["tracks"]["crime"]["group"]["share"] == 1
        assert summary["together"]["group"]["of"] == 1 and summary["mean_of_tracks"]["group"] == 0
        assert sum(map(sum, summary["confusion"]["matrix"])) == 1
        assert set(summary["by_form"]) == {"creep: a form"} and summary["by_form"]["creep: a form"]["cases"] == 1

    def test_tracks_have_equal_weights_in_their_mean(self):
        right, wrong = (answer(named(n)) for n in ("creep", "hum"))
        many = [grade(labels(effect("creep")), right)] * 3
        one = [grade(labels(effect("creep"), track="open"), wrong)]
        summary = summarise([*many, *one])
        assert summary["mean_of_tracks"]["group"] == 0.5 and summary["together"]["group"]["share"] == 0.75

    @pytest.mark.parametrize(
        ("truth", "said", "cell"),
        [
            (["creep"], answer(named("creep")), ("creep", "creep")),
            (["amplifier_lag"], answer(named("sensor_lag")), ("amplifier_lag", "sensor_lag")),
            (["creep"], answer(named("hum"), named("delay")), ("creep", "hum")),
            (["creep"], answer(verdict="unexplained"), ("creep", "abstained")),
            (["creep"], answer(verdict="nothing_missing"), ("creep", "nothing")),
            (["creep"], answer(named("gremlins")), ("creep", "other")),
            (["creep"], None, ("creep", "failed")),
            ([], answer(verdict="nothing_missing"), ("nothing", "nothing")),
            ([], answer(verdict="partly_explained"), ("nothing", "abstained")),
        ],
    )
    def test_the_confusion_matrix_has_abstention_and_failure(self, truth, said, cell):
        matrix = summarise([grade(labels(*map(effect, truth)), said)])["confusion"]
        row, column = matrix["truth"].index(cell[0]), matrix["answer"].index(cell[1])
        assert matrix["matrix"][row][column] == 1 and sum(map(sum, matrix["matrix"])) == 1

    def test_the_confusion_matrix_has_single_effects_only(self):
        two = grade(labels(effect("creep"), effect("hum")), answer(named("creep")))
        assert sum(map(sum, summarise([two])["confusion"]["matrix"])) == 0

    def test_detection_is_counted_by_severity_and_by_what_plays_leave(self):
        rows = summarise([grade(labels(effect("creep", 12.0)), answer(named("creep"), named("hum")))])["detection"]
        filled = [(r["measure"], r["from"], r["to"]) for r in rows if r["right_group"]["of"]]
        assert filled == [("severity", 10.0, 20.0), ("severity_beyond_plays", 5.0, 10.0)]
        assert all(r["right_group"]["count"] == r["wrong"]["count"] == 1 for r in rows if r["right_group"]["of"])
        poor = grade(labels(effect("creep"), adequate=False), answer())
        without = grade(labels(effect("creep") | {"severity_beyond_plays": None}), answer())
        counts = [sum(r["right_group"]["of"] for r in summarise([g])["detection"]) for g in (poor, without)]
        assert counts == [0, 1]

    def test_the_bins_of_severity_are_those_that_are_published(self):
        edges = [0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0]
        grades = [grade(labels(effect("creep", edge)), answer(named("creep"))) for edge in edges]
        rows = [r for r in summarise(grades)["detection"] if r["measure"] == "severity"]
        assert [(r["from"], r["to"]) for r in rows] == list(zip([0.0, *edges[1:]], [*edges[1:], None], strict=True))
        assert all(r["right_group"]["of"] == 1 for r in rows)

    def test_tables_by_effect_form_and_truth_have_their_own_cases(self):
        creep, hum = effect("creep", 5.0, form="poles"), effect("hum", 1.0)
        grades = [
            grade(labels(creep), answer(named("creep"))),
            grade(labels(hum, family="duhem"), answer(named("ageing"))),
            grade(labels(), answer(verdict="nothing_missing")),
        ]
        outside = grade(labels(effect("echo", listed=False)), answer())
        assert set(summarise([outside])["by_effect"]) == {"echo"}
        summary = summarise(grades)
        assert set(summary["by_effect"]) == {"creep", "hum", "nothing"}
        assert set(summary["by_form"]) == {"creep: poles", "hum: a form", "nothing: –"}
        assert set(summary["by_truth"]) == {"pi", "duhem"} and summary["by_truth"]["pi"]["cases"] == 2
        assert summary["by_effect"]["creep"]["group"] == share(1, 1)
        assert summary["by_effect"]["hum"]["group"] == share(0, 0)  # faint
        assert summary["by_effect"]["hum"]["wrong"] == share(1, 1)

    def test_the_worst_cases_are_wrong_names_then_failures_then_misses(self):
        cases = {
            "wrong": (labels(effect("hum")), answer(named("creep"))),
            "failed": (labels(), None),
            "missed": (labels(effect("creep", 30.0)), answer(verdict="unexplained")),
            "faint": (labels(effect("creep", 1.0)), answer(verdict="unexplained")),
            "just": (labels(effect("creep", 2.0)), answer(verdict="unexplained")),
            "good": (labels(effect("creep")), answer(named("creep"))),
        }
        grades = [grade(label | {"case": name}, said) for name, (label, said) in cases.items()]
        for name, verdict, ratio in (("far", "explained", 3.0), ("open", "unexplained", 9.0), ("near", "explained", 1.9)):
            given = {"predicted_um": np.full(9, ratio * NOISE_UM), "measured_um": np.zeros(9)}
            grades.append(grade(labels(case=name), answer(verdict=verdict), **given))
        worst = summarise(grades)["worst"]
        assert worst == [f"alien/{name}" for name in ("wrong", "failed", "missed", "just", "far")]
        assert len(summarise([grades[0]] * 12)["worst"]) == 10


class TestBounds:
    def test_bounds_are_those_of_clopper_and_pearson(self):
        assert share(0, 299)["at_most"] == pytest.approx(1 - 0.05 ** (1 / 299)) and share(0, 299)["at_most"] < 0.01
        assert share(59, 59)["at_least"] == pytest.approx(0.05 ** (1 / 59))
        assert share(59, 59)["at_most"] == 1 and share(0, 5)["at_least"] == 0
        some = share(7, 10)  # tables of Clopper and Pearson (1934), one-sided 95 %
        assert some["at_least"] == pytest.approx(0.3934, abs=1e-4)
        assert some["at_most"] == pytest.approx(0.9127, abs=1e-4)

    def test_none_of_none_has_no_share(self):
        assert share(0, 0)["share"] is None


class TestCalibration:
    def test_a_tool_that_is_right_as_often_as_it_states_has_no_more_error_than_chance(self):
        rng = np.random.default_rng(1)
        probabilities = rng.uniform(0, 1, 4000)
        found = reliability(probabilities, rng.random(4000) < probabilities)
        assert found["expected_calibration_error"] < found["by_chance"]["below"] < 0.03
        assert found["brier"] == pytest.approx(1 / 6, abs=0.01)

    def test_a_tool_that_is_too_sure_has_the_excess_as_its_error(self):
        found = reliability(np.full(1000, 0.95), np.arange(1000) % 10 < 7)
        assert found["expected_calibration_error"] == pytest.approx(0.25)
        (only,) = found["bins"]
        assert only["at_least"] < 0.7 < only["at_most"] < 0.95

    def test_bins_of_a_tenth_are_weighted_by_their_names(self):
        probabilities, right = np.array([0.05] * 3 + [0.15] + [1.0]), np.array([0, 0, 0, 1, 1], dtype=bool)
        found = reliability(probabilities, right)
        assert [b["of"] for b in found["bins"]] == [3, 1, 1]
        assert found["expected_calibration_error"] == pytest.approx((3 * 0.05 + 0.85) / 5)

    def test_names_that_are_tolerated_or_without_a_probability_are_left_out(self):
        mode = labels(effect("creep"), tolerated=["resonance"])
        said = answer(named("creep", probability=0.6), named("resonance"), named("hum", probability=None))
        found = calibration([grade(mode, said).as_dict()])
        assert (found["names"], found["tolerated"], found["without_a_probability"]) == (1, 1, 1)
        assert found["by_itself"]["brier"] == pytest.approx(0.16)

    def test_an_alternative_is_right_as_a_group_only(self):
        found = grade(labels(effect("creep")), answer(named("leakage", "creep"))).stated
        assert [(s["right"], s["right_group"]) for s in found] == [(False, True)]
        group = grade(labels(effect("sensor_lag")), answer(named("amplifier_lag"))).stated
        assert [(s["right"], s["right_group"]) for s in group] == [(True, True)]


class TestInjected:
    """Real recordings, graded against the answer to the same recordings untouched."""

    def labels(self, name: str = "hum", *also: str, severity: float = 5.0, **more: object) -> dict:
        return {
            "track": "noise",
            "case": "case_0001",
            "source": "stack_sine",
            "kind": name,
            "name": name,
            "form": "a form",
            "accepted": [name, *also],
            "severity": severity,
            "noise_rms_um": NOISE_UM,
            "parameters": {},
        } | more

    def of(self, label: dict, said: dict | None, before: dict | None = None) -> object:
        return grade_injected(label, said, answer(verdict="unexplained") if before is None else before)

    def test_a_new_name_of_the_truth_is_right_and_another_is_wrong_even_beside_it(self):
        graded = self.of(self.labels(), answer(named("hum"), named("creep")))
        assert graded.exact == graded.found == ["hum"] and graded.wrong == ["creep"]

    def test_a_name_that_cannot_be_split_from_the_truth_is_right_but_not_exact(self):
        graded = self.of(self.labels("sensor_lag", "amplifier_lag"), answer(named("amplifier_lag")))
        assert graded.found == ["sensor_lag"] and not graded.exact

    def test_the_truth_among_five_names_is_right_and_among_six_is_wrong(self):
        few, many = ["hum"], ["hum", "creep", "leakage", "ageing", "backlash"]
        assert self.of(self.labels(), answer(named("delay", *few))).found == ["hum"]
        graded = self.of(self.labels(), answer(named("delay", *many)))
        assert not graded.found and graded.wrong == ["delay"]

    def test_what_the_untouched_recording_has_is_not_charged(self):
        assert not self.of(self.labels(), answer(named("creep")), answer(named("creep"))).wrong
        assert not self.of(self.labels(), answer(named("ageing")), answer(named("creep", "ageing"))).wrong
        assert self.of(self.labels(), answer(named("ageing")), answer(named("creep"))).wrong == ["ageing"]

    def test_another_name_of_a_group_is_new_only_where_the_first_is_still_there(self):
        before = answer(named("hysteresis_operator"))
        assert not self.of(self.labels(), answer(named("incongruent_loops")), before).wrong
        both = answer(named("hysteresis_operator"), named("incongruent_loops"))
        assert self.of(self.labels(), both, before).wrong == ["incongruent_loops"]

    def test_a_name_that_was_there_and_grows_by_half_of_what_was_injected_is_right(self):
        label = self.labels(severity=10.0)  # 0.1 µm
        def said(retuned_um: float) -> dict:
            return answer(named("hum"), heldout_um=(retuned_um, 0.05))
        grown = self.of(label, said(0.3), said(math.sqrt(0.09 - 0.0051)))
        assert grown.found == ["hum"] and not grown.named_before
        same = self.of(label, said(0.3), said(math.sqrt(0.09 - 0.0049)))
        assert not same.found and same.named_before and not same.wrong
        summary = figures([same])
        assert summary["group"]["of"] == summary["precision"]["of"] == 0 and summary["named_before"] == 1
        assert sum(map(sum, summarise([same])["confusion"]["matrix"])) == 0
        assert all(row["right_group"]["of"] == 0 for row in summarise([same])["detection"])

    def test_the_floor_counts_neither_before_nor_after(self):
        label = self.labels(severity=10.0)
        before = answer(named("hum"), heldout_um=(0.2, 0.05))
        after = answer(named("hum"), heldout_um=(0.3, 0.05))
        after["fit"]["noise_floor_um"] = 0.29
        assert self.of(label, after, before).named_before

    def test_what_has_no_name_is_recognised_only_without_a_wrong_one(self):
        label = self.labels("cross_coupling", accepted=[])
        recognised = self.of(label, answer(verdict="unexplained"))
        assert recognised.unknown and not recognised.truth
        for said, counted in (
            (answer(verdict="unexplained"), 1),
            (answer(), 0),
            (answer(named("creep"), verdict="unexplained"), 0),
        ):
            assert figures([self.of(label, said)])["unknown"]["count"] == counted

    def test_without_either_answer_the_case_has_failed(self):
        good = answer(verdict="unexplained")
        for said, before in ((None, good), (good, None), ({"verdict": "?"}, good)):
            graded = grade_injected(self.labels(), said, before)
            assert graded.failed and not graded.found and not graded.wrong
        assert figures([grade_injected(self.labels(), None, good)])["group"] == share(0, 1)

    def test_a_tool_that_gives_no_account_of_its_fit_is_graded_by_its_names(self):
        bare = {"verdict": "explained", "effects": [named("hum")]}
        graded = self.of(self.labels(severity=1e3), bare, {"verdict": "unexplained", "effects": []})
        assert graded.found == ["hum"] and graded.over_residual is None
        assert self.of(self.labels(severity=1e3), bare, bare).named_before

    def test_it_is_counted_from_three_times_what_was_left(self):
        def case(severity: float, *said: dict) -> object:  # 0.5 µm are left of the untouched recording
            return self.of(self.labels(severity=severity), answer(*said))
        grades = [case(151.0, named("hum")), case(151.0), case(149.0, named("hum"))]
        assert figures(grades)["injected"] == share(1, 2)
        assert figures([*grades, case(10.0, named("creep"))])["injected_wrong"] == share(1, 4)
        simulated = grade(labels(effect("creep")), answer(named("hum")))
        assert figures([simulated])["injected"]["of"] == figures([simulated])["injected_wrong"]["of"] == 0

    def test_parameters_of_a_new_exact_name_are_compared_and_of_an_old_one_are_not(self):
        label = self.labels(parameters={"mains_hz": value(50.0, "Hz")})
        said = answer(named("hum", frequency=value(51.0, "Hz", [49.0, 52.0])))
        (row,) = self.of(label, said).parameters
        assert row["relative_error"] == pytest.approx(0.02) and row["covered"]
        assert not self.of(label, said, said).parameters
