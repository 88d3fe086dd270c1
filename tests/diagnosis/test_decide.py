"""The decision from hand-made beliefs: each rule with one case that passes and one that does not."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from torchpi.diagnosis.decide import (
    NAMED,
    OPERATORS,
    POSSIBLE,
    Decision,
    clear_of_none,
    decide,
    if_it_carries_over,
    verdict,
)
from torchpi.diagnosis.diagnose import with_read_off
from torchpi.diagnosis.diagnosis import AcrossRecordings
from torchpi.diagnosis.free_parameters import slot
from torchpi.diagnosis.hypothesis import EffectTerm, Hypothesis
from torchpi.diagnosis.hysteresis_model import HysteresisModel
from torchpi.diagnosis.posterior import HALF, Believed
from torchpi.diagnosis.rival_models import OPERATOR_NAME
from torchpi.stage.effects.actuator.creep import Creep
from torchpi.stage.effects.mechanics.backlash import Backlash
from torchpi.stage.effects.mechanics.load_change import LoadChange
from torchpi.stage.effects.sensor.sensor_lag import SensorLag

NOISE = SimpleNamespace(rms_um=2.0)
TERMS = (
    EffectTerm(Creep, {"per_decade": 0.02}),
    EffectTerm(Backlash, {"width_um": 0.1}),
    EffectTerm(SensorLag, {"cutoff_hz": 100.0}),
)


def believed(name: str, explained_um2: float, probability: float = 0.9, *alternatives: str) -> Believed:
    return Believed(name, probability, alternatives, explained_um2, (), HALF)


def left(train: float, heldout: float | None = None) -> SimpleNamespace:
    """Return a fit with these rms residuals and no fitted parameter that has an interval."""
    hypothesis = Hypothesis(HysteresisModel(np.zeros(1)))
    for term in TERMS:
        hypothesis = hypothesis.plus(term)
    return SimpleNamespace(
        train_rms=train,
        heldout_rms=train if heldout is None else heldout,
        slots=(),
        theta=(),
        hypothesis=hypothesis,
    )


def decided(*each: Believed, retuned: float = 10.0, final: float = 2.0, **more: object) -> Decision:
    search = SimpleNamespace(
        chain=SimpleNamespace(records=()),
        effects_tried=[Creep, Backlash, SensorLag],
        jump=more.pop("jump", None),
        slips=more.pop("slips", None),
    )
    given = {"noise": NOISE, "structured": False, "loud": False} | more
    return decide(search, left(retuned), left(final), each, *given.values())


class TestNames:
    def test_effects_at_least_as_likely_as_not_are_named_and_the_others_stay_open(self) -> None:
        found = decided(believed("creep", 48.0, NAMED), believed("sensor_lag", 24.0, NAMED - 0.01))
        assert [one.name for one in found.effects] == ["creep"]
        assert [one.name for one in found.open] == ["sensor_lag"]

    def test_an_effect_that_explains_less_than_a_fifth_of_the_noise_is_neither_named_nor_open(self) -> None:
        assert [one.name for one in decided(believed("creep", 0.164), final=6.0).effects] == ["creep"]
        faint = decided(believed("creep", 0.156), believed("sensor_lag", 0.156, 0.1), final=1.0)
        assert not faint.effects and not faint.open

    def test_without_measured_noise_the_remaining_residual_takes_its_place(self) -> None:
        assert decided(believed("creep", 0.68), final=4.0, noise=None).effects
        assert not decided(believed("creep", 0.6), final=4.0, noise=None).effects

    @pytest.mark.parametrize(("half", "probability"), [(0.03, 0.0), (0.01, 0.45), (0.0025, 0.9)])
    def test_an_effect_whose_interval_includes_zero_loses_its_probability_unless_it_follows_a_recorded_signal(
        self, half: float, probability: float
    ) -> None:
        """The probability is halved where the interval just reaches 0."""
        quantity = LoadChange.quantities["stiffness_ratio"]
        ratio = slot(0, "stiffness_ratio", None, 0.01, quantity, 1e-4)
        hypothesis = Hypothesis(HysteresisModel(np.zeros(1))).plus(
            EffectTerm(LoadChange, {"stiffness_ratio": 0.01})
        )
        fit = SimpleNamespace(slots=(ratio,), theta=(1.0,), hypothesis=hypothesis)
        one, covariance = believed("load_change", 48.0, 0.9), np.array([[(half / 0.01) ** 2]])
        assert clear_of_none(one, fit, covariance).probability == pytest.approx(probability, abs=2e-3)
        recorded = replace(one, recorded=True)
        assert clear_of_none(recorded, fit, covariance) == recorded

    def test_a_stick_slip_jump_takes_the_place_of_backlash(self) -> None:
        assert [one.form for one in decided(believed("backlash", 48.0)).effects] == ["play"]
        jump = (0.1, (0.05, 0.15))
        assert not decided(believed("backlash", 48.0), jump=jump).effects
        assert [one.name for one in decided(believed("creep", 48.0), jump=jump).effects] == ["creep"]

    @pytest.mark.parametrize(
        ("final", "noise", "structured", "named"),
        [
            (2.0, NOISE, True, True),
            (4.0, NOISE, False, False),
            (4.0, None, False, True),
            (4.0, None, True, False),
        ],
    )
    def test_a_play_is_named_only_beside_a_residual_that_an_unlisted_hysteresis_does_not_leave(
        self, final: float, noise: object, structured: bool, named: bool
    ) -> None:
        each = believed("backlash", 48.0), believed("creep", 24.0)
        found = decided(*each, final=final, noise=noise, structured=structured)
        assert ("backlash" in {one.name for one in found.effects}) == named
        assert "creep" in {one.name for one in found.effects}
        assert ("backlash" in {one.name for one in found.causes_left_open}) != named
        seen_to_stick = decided(*each, final=final, noise=noise, structured=structured, slips="slips")
        assert "backlash" in {one.name for one in seen_to_stick.effects}

    def test_effects_are_ordered_by_their_share_of_the_residual_above_the_noise(self) -> None:
        found = decided(believed("creep", 24.0, 0.9, "leakage"), believed("sensor_lag", 48.0))
        assert [(one.name, one.share) for one in found.effects] == [("sensor_lag", 0.5), ("creep", 0.25)]
        assert found.effects[1].alternatives == ("leakage",) and found.effects[1].form == "logarithm"
        more = decided(
            believed("creep", 144.0), believed("sensor_lag", 48.0)
        )  # together more than the 96 that retuning left
        assert [one.share for one in more.effects] == [0.75, 0.25]

    def test_the_hysteresis_is_named_with_its_family(self) -> None:
        (found,) = decided(believed(OPERATOR_NAME, 48.0)).effects
        assert found.parameters[0].value == "prandtl_ishlinskii"
        assert found.equation == OPERATORS["prandtl_ishlinskii"]


class TestOpen:
    def test_only_effects_that_are_probable_and_large_enough_are_left_open(self) -> None:
        found = decided(
            believed("creep", 48.0),
            believed("sensor_lag", 24.0, 0.3),
            believed("delay", 20.0, 0.04),
            believed("hum", 0.01, 0.4),
        )
        assert [one.name for one in found.effects] == ["creep"]
        assert [(one.name, one.probability) for one in found.causes_left_open] == [("sensor_lag", 0.3)]


class TestUnexplained:
    def test_the_unexplained_share_is_the_residual_above_the_noise_plus_that_of_open_effects(self) -> None:
        found = decided(believed("creep", 48.0), final=np.sqrt(28.0))
        assert found.unexplained_share == pytest.approx(24.0 / 96.0)
        open_too = decided(believed("creep", 48.0), believed("sensor_lag", 24.0, 0.1), final=np.sqrt(28.0))
        assert open_too.unexplained_share == pytest.approx(48.0 / 96.0)
        assert decided(believed("sensor_lag", 80.0, 0.1), final=8.0).unexplained_share == 1.0
        louder = decided(believed("creep", 48.0), final=5.0, noise=SimpleNamespace(rms_um=3.0))
        assert louder.unexplained_share == pytest.approx(16.0 / 91.0)

    def test_the_form_error_of_a_named_effect_is_attributed_to_that_effect(self) -> None:
        form = replace(believed("sensor_lag", 4.0, 0.0), form_of="creep")
        found = decided(believed("creep", 92.0), form)
        assert found.verdict == "explained" and not found.open
        assert found.unexplained_share == 0.0 and found.effects[0].share == pytest.approx(1.0)
        # Not if the error without it would exceed that of an explained verdict, or its effect is not named.
        assert decided(believed("creep", 90.0), replace(form, explained_um2=6.0)).open
        assert decided(believed("creep", 92.0, 0.1), form).verdict == "unexplained"
        assert decided(believed("creep", 92.0), replace(form, form_of="delay")).open

    @given(st.floats(0, 300), st.floats(0, 300), st.floats(0, 20), st.sampled_from([0.1, 0.9]))
    def test_the_named_and_the_unexplained_shares_sum_to_at_most_one(
        self, slow: float, late: float, final: float, probability: float
    ) -> None:
        """Also if the data cannot separate two effects, or the final fit leaves more than the retuned one."""
        found = decided(believed("creep", slow), believed("sensor_lag", late, probability), final=final)
        shares = sum(one.share for one in found.effects) + found.joint_share
        assert shares + found.unexplained_share <= 1 + 1e-12

    @given(st.floats(1, 40), st.floats(1, 40), st.floats(0, 4))
    def test_the_shares_and_the_joint_share_sum_to_one(self, slow: float, late: float, final: float) -> None:
        """The joint share is the rest: without either effect, the other stands in for part of it."""
        found = decided(believed("creep", slow), believed("sensor_lag", late), final=final)
        shares = sum(one.share for one in found.effects)
        assert found.joint_share >= 0
        assert shares + found.joint_share + found.unexplained_share == pytest.approx(1.0)

    def test_the_shares_still_sum_to_one_with_an_effect_read_off_the_readings(self) -> None:
        before = decided(believed("creep", 48.0), believed("sensor_lag", 24.0), final=3.0)
        found = with_read_off(before, replace(before.effects[0], name="quantization", share=0.4))
        shares = [one.share for one in found.effects]
        assert shares == pytest.approx([0.6 * 0.5, 0.6 * 0.25, 0.4])
        assert sum(shares) + found.joint_share + found.unexplained_share == pytest.approx(1.0)

    def test_a_single_effect_explains_all_that_the_fit_removed(self) -> None:
        """Left out alone, it may be refitted to less than the retuned stage leaves, under other weights."""
        found = decided(believed("creep", 48.0), final=3.0)
        assert found.joint_share == 0.0
        assert found.effects[0].share == pytest.approx(91.0 / 96.0)
        assert found.effects[0].share + found.unexplained_share == pytest.approx(1.0)

    def test_what_the_only_likely_effect_explains_with_unlikely_ones_is_attributed_to_it(self) -> None:
        found = decided(believed("creep", 24.0), believed("sensor_lag", 12.0, POSSIBLE - 0.01))
        assert found.joint_share == 0.0
        assert found.effects[0].share == pytest.approx(84.0 / 96.0)
        assert decided(believed("creep", 24.0), believed("sensor_lag", 12.0, POSSIBLE + 0.01)).joint_share > 0

    def test_a_residual_below_the_noise_does_not_reduce_the_share_of_open_effects(self) -> None:
        found = decided(believed("creep", 48.0), believed("sensor_lag", 24.0, 0.1), final=1.0)
        assert found.unexplained_share == pytest.approx(24.0 / 96.0)

    def test_the_unexplained_share_is_zero_if_nothing_is_missing_or_the_noise_is_unknown(self) -> None:
        assert decided(final=2.2).unexplained_share == 0.0
        assert decided(believed("creep", 48.0), final=6.0, noise=None).unexplained_share == 0.0

    def test_the_noise_is_stated_only_if_it_was_measured(self) -> None:
        assert decided().noise_um == 2.0 and decided(noise=None).noise_um is None

    @pytest.mark.parametrize(("rms_um", "found"), [(3.0, "explained"), (3.1, "partly_explained")])
    def test_a_recording_the_others_do_not_predict_is_not_explained(self, rms_um: float, found: str) -> None:
        across = (AcrossRecordings("a", 2.0, 2.0), AcrossRecordings("b", rms_um, 2.0))
        assert if_it_carries_over(decided(believed("creep", 48.0)), across).verdict == found
        assert if_it_carries_over(decided(), across).verdict == "nothing_missing"

    def test_an_untested_larger_hysteresis_is_explained_only_if_a_recording_predicts_another(self) -> None:
        explained = decided(believed("creep", 48.0))
        alone = if_it_carries_over(explained, (), 0.0, 2.0, untested=True)
        assert alone.verdict == "partly_explained" and not alone.carries_over
        across = (AcrossRecordings("a", 2.0, 2.0),)
        assert if_it_carries_over(explained, across, 0.0, 2.0, untested=True).verdict == "explained"
        assert if_it_carries_over(explained, (), untested=True).verdict == "explained"

    @pytest.mark.parametrize(("another_um", "carries_over"), [(0.0, True), (2.2, True), (2.3, False)])
    def test_a_hysteresis_that_other_motions_find_uncertain_is_not_explained(
        self, another_um: float, carries_over: bool
    ) -> None:
        """With 1.12 times the noise beside it, the residual grows to 1.5 times the noise."""
        found = if_it_carries_over(decided(believed("creep", 48.0)), (), another_um, 2.0)
        assert found.carries_over == carries_over
        assert found.verdict == ("explained" if carries_over else "partly_explained")

    def test_an_open_effect_or_a_conspicuous_residual_prevents_the_verdict_explained(self) -> None:
        assert decided(believed("creep", 48.0)).verdict == "explained"
        assert decided(believed("creep", 48.0), loud=True).verdict == "partly_explained"
        assert (
            decided(believed("creep", 48.0), believed("sensor_lag", 24.0, 0.1)).verdict == "partly_explained"
        )
        assert decided(believed("sensor_lag", 24.0, 0.1)).verdict == "unexplained"


class TestVerdict:
    @pytest.mark.parametrize(
        ("named", "more", "rms", "expected"),
        [
            ([], False, 1.14, "nothing_missing"),
            ([], False, 1.16, "unexplained"),
            ([], True, 1.14, "unexplained"),
            (["creep"], False, 1.49, "explained"),
            (["creep"], False, 1.51, "partly_explained"),
            (["creep"], True, 1.14, "partly_explained"),
        ],
    )
    def test_the_error_over_noise_decides(self, named: list, more: bool, rms: float, expected: str) -> None:
        for fit in (left(2 * rms), left(0.1, 2 * rms)):
            assert verdict(named, more, fit, SimpleNamespace(rms_um=2.0), True) == expected

    @pytest.mark.parametrize(
        ("named", "structured", "expected"),
        [
            ([], False, "nothing_missing"),
            ([], True, "unexplained"),
            (["creep"], False, "explained"),
            (["creep"], True, "partly_explained"),
        ],
    )
    def test_structure_decides_for_unknown_noise(self, named: list, structured: bool, expected: str) -> None:
        assert verdict(named, False, left(9.0), None, structured) == expected
