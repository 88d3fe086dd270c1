"""How an answer on a real recording with a known effect in it is graded."""

import math

import pytest
from concealed.judging.grade import grade
from concealed.judging.proportions import share
from concealed.judging.summary import figures, summarise
from concealed.real.grade import grade_injected
from hand_made import NOISE_UM, answer, effect, labels, named, value


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
        missed = self.of(self.labels(), answer(named("creep")))
        assert not missed.found and not missed.named_before

    def test_a_name_that_cannot_be_split_from_the_truth_is_right_but_not_exact(self):
        graded = self.of(self.labels("sensor_lag", "amplifier_lag"), answer(named("amplifier_lag")))
        assert graded.found == ["sensor_lag"] and not graded.exact

    def test_the_truth_among_five_names_is_right_and_among_six_is_wrong(self):
        few, many = ["hum", "creep", "leakage", "ageing"], ["hum", "creep", "leakage", "ageing", "backlash"]
        assert self.of(self.labels(), answer(named("delay", *few))).found == ["hum"]
        graded = self.of(self.labels(), answer(named("delay", *many)))
        assert not graded.found and graded.wrong == ["delay"]
        assert self.of(self.labels("creep"), answer(named("creep", *many, "delay"))).exact == ["creep"]

    def test_what_the_untouched_recording_has_is_not_charged(self):
        same = self.of(self.labels(), answer(named("creep")), answer(named("creep")))
        assert not same.wrong and not same.named_before
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
        before["fit"]["noise_floor_um"] = after["fit"]["noise_floor_um"] = 0.1
        assert self.of(label, after, before).found == ["hum"]
        del after["effects"][0]["share"]
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
        assert figures([self.of(self.labels(), None)])["injected_wrong"]["of"] == 0
        withheld = self.labels("cross_coupling", accepted=[], severity=None)
        unnamed = self.of(withheld, answer())
        assert unnamed.over_residual is None and unnamed.severities == {"cross_coupling": 0.0}
        simulated = grade(labels(effect("creep")), answer(named("hum")))
        assert figures([simulated])["injected"]["of"] == figures([simulated])["injected_wrong"]["of"] == 0

    def test_the_exact_name_is_taken_before_an_accepted_one_and_that_before_an_alternative(self):
        label = self.labels("sensor_lag", "amplifier_lag", parameters={"cutoff_hz": value(100.0, "Hz")})
        lag = named("amplifier_lag", cutoff_hz=value(90.0, "Hz"))
        said = [named("delay", "sensor_lag"), lag, named("sensor_lag", cutoff_hz=value(80.0, "Hz"))]
        exact, accepted, alternative = (self.of(label, answer(*said[:n])) for n in (3, 2, 1))
        assert exact.exact == ["sensor_lag"] and exact.tolerated == ["delay", "amplifier_lag"]
        assert [row["relative_error"] for row in exact.parameters] == [pytest.approx(0.2)]
        assert accepted.found == ["sensor_lag"] and not accepted.exact and not accepted.parameters
        assert accepted.tolerated == ["delay"] and [s["name"] for s in accepted.stated] == ["amplifier_lag"]
        assert alternative.found == ["sensor_lag"] and not alternative.tolerated
        wrong = self.of(label, answer(named("creep"), named("ageing")), answer(named("ageing")))
        assert (wrong.tolerated, wrong.wrong) == (["ageing"], ["creep"])

    def test_probabilities_are_graded_by_name_and_by_group_and_what_was_there_is_left_out(self):
        said = answer(named("delay", "hum"), named("creep"), named("ageing"))
        found = self.of(self.labels(), said, answer(named("ageing"))).stated
        assert [(s["name"], s["right"], s["right_group"]) for s in found] == [
            ("delay", False, True),
            ("creep", False, False),
        ]
        (exact,) = self.of(self.labels("sensor_lag", "amplifier_lag"), answer(named("amplifier_lag"))).stated
        assert exact["right"] and exact["right_group"] and exact["probability"] == 0.9

    def test_parameters_of_a_new_exact_name_are_compared_and_of_an_old_one_are_not(self):
        label = self.labels(parameters={"mains_hz": value(50.0, "Hz")})
        said = answer(named("hum", frequency=value(51.0, "Hz", [49.0, 52.0])))
        (row,) = self.of(label, said).parameters
        assert row["relative_error"] == pytest.approx(0.02) and row["covered"]
        assert not self.of(label, said, said).parameters
