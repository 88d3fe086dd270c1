"""Every figure over graded answers: what it counts, what it counts against, what it leaves out."""

import numpy as np
import pytest
from concealed.judging.calibration import calibration, reliability
from concealed.judging.grade import grade
from concealed.judging.proportions import share
from concealed.judging.summary import FIGURES, figures, summarise
from concealed.names import STATIC
from hand_made import NOISE_UM, answer, effect, labels, named, value


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
        excused = grade(
            labels(family="preisach", tolerated=sorted(STATIC)), answer(named("hysteresis_operator"))
        )
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

    def test_an_effect_of_the_list_is_not_outside_it(self):
        listed = grade(labels(effect("creep")), answer(verdict="unexplained"))
        for key in ("unknown", "unknown_right", "unknown_improves"):
            assert self.of(key, listed) == (0, 0)

    def test_the_bound_that_is_quoted_is_the_one_on_the_worse_side(self):
        assert {key for key, _, _, more_is_better in FIGURES if not more_is_better} == {
            "failed",
            "false_alarms",
            "foreign_wrong",
            "calibration_error",
            "parameter_error",
            "heldout",
            "closed_far",
            "injected_wrong",
            "named_before",
            "seconds",
        }

    @pytest.mark.parametrize(
        ("gain", "counted"), [(0.02, True), (0.006, True), (0.004, False), (-0.2, False)]
    )
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

        grades = [
            with_interval(5.0, [0.9, 1.3]),
            with_interval(2.0, [1.1, 1.3]),
            with_interval(1.9, [0.9, 1.3]),
        ]
        assert self.of("intervals", *grades) == (1, 2)
        assert figures(grades)["parameter_error"] == pytest.approx(0.2)
        assert figures(grades[2:])["parameter_error"] is None
        lag = effect("creep", 5.0, parameters={"tau_s": value(1.0, "s"), "share": value(1.0, "1")})
        bare = grade(labels(lag), answer(named("creep", tau_s=value(1.1, "s"))))
        assert self.of("intervals", bare) == (0, 0) and figures([bare])["parameter_error"] == pytest.approx(
            0.1
        )
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
        assert (
            set(summary["by_form"]) == {"creep: a form"} and summary["by_form"]["creep: a form"]["cases"] == 1
        )

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
            (["amplifier_lag"], answer(named("hum"), named("sensor_lag")), ("amplifier_lag", "sensor_lag")),
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

    def test_the_confusion_matrix_counts_no_tolerated_name(self):
        lag = labels(effect("amplifier_lag"), tolerated=["hum"])
        matrix = summarise([grade(lag, answer(named("hum"), named("sensor_lag")))])["confusion"]
        row, column = matrix["truth"].index("amplifier_lag"), matrix["answer"].index("sensor_lag")
        assert matrix["matrix"][row][column] == 1

    def test_the_confusion_matrix_has_single_effects_only(self):
        two = grade(labels(effect("creep"), effect("hum")), answer(named("creep")))
        beside = grade(labels(effect("creep"), effect("echo", listed=False)), answer(named("creep")))
        assert sum(map(sum, summarise([two, beside])["confusion"]["matrix"])) == 0

    def test_detection_is_counted_by_severity_and_by_what_plays_leave(self):
        rows = summarise([grade(labels(effect("creep", 12.0)), answer(named("creep"), named("hum")))])[
            "detection"
        ]
        filled = [(r["measure"], r["from"], r["to"]) for r in rows if r["right_group"]["of"]]
        assert filled == [("severity", 10.0, 20.0), ("severity_beyond_plays", 5.0, 10.0)]
        assert all(
            r["right_group"]["count"] == r["wrong"]["count"] == 1 for r in rows if r["right_group"]["of"]
        )
        poor = grade(labels(effect("creep"), adequate=False), answer())
        without = grade(labels(effect("creep") | {"severity_beyond_plays": None}), answer())
        counts = [sum(r["right_group"]["of"] for r in summarise([g])["detection"]) for g in (poor, without)]
        assert counts == [0, 1]

    def test_the_bins_of_severity_are_those_that_are_published(self):
        edges = [0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0]
        grades = [grade(labels(effect("creep", edge)), answer(named("creep"))) for edge in edges]
        rows = [r for r in summarise(grades)["detection"] if r["measure"] == "severity"]
        assert [(r["from"], r["to"]) for r in rows] == list(
            zip([0.0, *edges[1:]], [*edges[1:], None], strict=True)
        )
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
        for name, verdict, ratio in (
            ("far", "explained", 3.0),
            ("open", "unexplained", 9.0),
            ("near", "explained", 1.9),
        ):
            given = {"predicted_um": np.full(9, ratio * NOISE_UM), "measured_um": np.zeros(9)}
            grades.append(grade(labels(case=name), answer(verdict=verdict), **given))
        worst = summarise(grades)["worst"]
        assert worst == [f"alien/{name}" for name in ("wrong", "failed", "missed", "just", "far")]
        assert len(summarise([grades[0]] * 12)["worst"]) == 10


class TestBounds:
    def test_bounds_are_those_of_clopper_and_pearson(self):
        assert (
            share(0, 299)["at_most"] == pytest.approx(1 - 0.05 ** (1 / 299))
            and share(0, 299)["at_most"] < 0.01
        )
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
        rows = [(b["from"], b["to"], b["probability"], b["of"]) for b in found["bins"]]
        assert rows == [
            pytest.approx(row) for row in ((0, 0.1, 0.05, 3), (0.1, 0.2, 0.15, 1), (0.9, 1, 1, 1))
        ]
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
