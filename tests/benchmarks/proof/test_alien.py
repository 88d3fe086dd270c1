"""Alien plants: what each form does, and how a case is drawn, recorded and sealed."""

from dataclasses import replace

import numpy as np
import pytest
from concealed.alien.case import LISTED, NULL_OF_FOUR, OPEN, draw_case
from concealed.alien.excitation import BROAD, LOOPS, POOR, command, draw_waves
from concealed.alien.hysteresis import FAMILIES, draw_truth
from concealed.alien.rig import PLACES, Form, Rig, simulate
from concealed.names import NAMES
from concealed.plant.rig import Run
from concealed.plant.severity import misfit_um

SAMPLES, FS_HZ = 2000, 2000.0
# What no small strength can undo: a delay of whole ticks, a mode of any frequency in the band, the bandwidth
# that an amplifier has at most.
NEVER_FAINT = {"delay", "resonance", "amplifier_lag", "slew_limit"}


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def rig(**other: object) -> Rig:
    truths = [draw_truth(family, rng(1), 10.0, 20.0) for family in ("pi", "duhem")]
    plain = Rig(*truths, FS_HZ, 8, 0.0, 10.0, 20.0, 1.0, 5e-3, False, 3, SAMPLES)
    return replace(plain, **other)


def runs() -> list[Run]:
    u = [command(wave, rng(k), SAMPLES, 0.0, 10.0, False) for k, wave in enumerate((BROAD[0], LOOPS[1]))]
    aux = 5 * np.sin(np.arange(SAMPLES) / 90)
    return [Run(v, aux, k, k == 1) for k, v in enumerate(u)]


def readings(acts: list, of: Rig) -> np.ndarray:
    time_s = np.arange(SAMPLES) / FS_HZ
    return np.concatenate([simulate(of, acts, run, time_s) for run in runs()])


class TestForms:
    def test_every_name_on_the_list_has_two_forms_of_which_the_library_lacks_one_at_least(self):
        assert set(LISTED.effects()) == set(NAMES) and len(OPEN.effects()) >= 12
        for effect in LISTED.effects():
            forms = LISTED.of(effect)
            assert len({form.form for form in forms}) >= 2
            assert sum(not form.foreign for form in forms) <= 1
        assert all(form.source for form in [*LISTED.all, *OPEN.all])
        assert not set(OPEN.effects()) & set(LISTED.effects())

    @pytest.mark.parametrize("form", [*LISTED.all, *OPEN.all], ids=lambda form: f"{form.effect}-{form.form}")
    def test_it_is_faint_at_its_weakest_and_clear_at_its_strongest(self, form: Form):
        drawn = form.draw(rng(2), rig(), runs())
        plain = readings([], rig())
        sizes = []
        for strength in (drawn.low, drawn.high):
            changed = readings([(form.place, lambda x, at, s=strength: drawn.act(x, at, s))], rig())
            assert np.all(np.isfinite(changed))
            sizes.append(misfit_um(changed, plain) / rig().noise_um)
        assert form.place in PLACES
        assert sizes[1] > 2 and (sizes[0] < 0.5 or form.effect in NEVER_FAINT)
        assert {unit for _, unit in drawn.parameters(drawn.start).values()} <= {
            "Hz",
            "s",
            "V/s",
            "V",
            "um",
            "um/V",
        }


class TestTruths:
    @pytest.mark.parametrize("family", FAMILIES)
    def test_they_have_a_loop_and_do_not_know_the_rate(self, family):
        truth = draw_truth(family, rng(5), 10.0, 20.0)
        leg = np.linspace(0, 10, 400)
        y = truth.respond(np.concatenate([leg, leg[::-1], leg, leg[::-1]]))
        assert y[0] == 0 and np.ptp(y[800:]) == pytest.approx(20.0, rel=0.02)
        assert 0.02 < np.max(y[1200:][::-1] - y[800:1200]) / np.ptp(y[800:]) < 0.25
        held = truth.respond(np.repeat(np.concatenate([leg, leg[::-1]]), 3))[::3]
        np.testing.assert_allclose(held, y[:800], atol=1e-9)

    def test_the_chain_kept_is_the_chain_simulated_anew(self):
        time_s, kept = np.arange(SAMPLES) / FS_HZ, {}
        form = LISTED.of("second_mode")[0]
        drawn = form.draw(rng(3), rig(), runs())
        acts = [(form.place, lambda x, at: drawn.act(x, at, 0.1))]
        for run in runs():
            np.testing.assert_array_equal(
                simulate(rig(), [], run, time_s, kept), simulate(rig(), [], run, time_s)
            )
            np.testing.assert_array_equal(
                simulate(rig(), acts, run, time_s, kept), simulate(rig(), acts, run, time_s)
            )

    def test_a_reading_before_the_write_is_a_tick_late_and_a_negative_gain_is_a_sign(self):
        time_s, run = np.arange(SAMPLES) / FS_HZ, runs()[0]
        plain = simulate(rig(), [], run, time_s)
        np.testing.assert_allclose(simulate(rig(late=True), [], run, time_s)[1:], plain[:-1], atol=1e-12)
        np.testing.assert_array_equal(simulate(rig(sign=-1.0), [], run, time_s), -plain)


class TestExcitation:
    @pytest.mark.parametrize("wave", [*BROAD, *LOOPS, *POOR], ids=lambda wave: wave.__name__)
    @pytest.mark.parametrize("rests", [True, False])
    def test_commands_start_at_zero_and_stay_within_the_limits(self, wave, rests):
        u = command(wave, rng(1), SAMPLES, -2.0, 10.0, rests)
        assert u.size == SAMPLES and u[0] == 0 and u.min() >= -2 - 1e-6 and u.max() <= 10 + 1e-6
        assert np.ptp(u) > 6 and np.all(np.isfinite(u))

    def test_poor_ones_are_not_adequate_and_a_fifth_of_all(self):
        drawn = [draw_waves(rng(seed), 3, 5000) for seed in range(200)]
        poor = [adequate for waves, adequate in drawn if set(waves) <= set(POOR)]
        assert 20 <= len(poor) <= 60 and not any(poor)
        assert not any(adequate for _, adequate in (draw_waves(rng(s), 1, 2000) for s in range(20)))


class TestCases:
    @pytest.mark.parametrize(("track", "index"), [("alien", 3), ("open", 5)])
    def test_a_seed_gives_the_same_case_again_with_every_label_that_the_judge_needs(self, track, index):
        one, again = draw_case(track, 7000, index), draw_case(track, 7000, index)
        for a, b in zip(one.recordings, again.recordings, strict=True):
            assert list(a)[:3] == ["time_s", "input_v", "output_um"]
            assert all(np.all(np.isfinite(column)) for column in a.values()) and np.all(
                np.diff(a["time_s"]) > 0
            )
            np.testing.assert_array_equal(a["output_um"], b["output_um"])
        (effect,) = one.labels["effects"]
        assert effect["listed"] is (track == "alien")
        assert {"form", "foreign", "foreseeable", "severity", "parameters"} <= effect.keys()
        assert set(one.heldout) == set(one.recordings[0])

    def test_every_fourth_case_is_a_null_and_every_effect_comes_once_before_any_twice(self):
        from concealed.alien.case import _draw_forms

        for track, of in (("alien", LISTED), ("open", OPEN), ("noise", LISTED)):
            drawn = [_draw_forms(track, 1, k, rng(k)) for k in range(240)]
            assert all(not forms for forms in drawn[NULL_OF_FOUR[track] :: 4])
            singles = [
                forms[0].effect
                for k, forms in enumerate(drawn)
                if len(forms) == 1 and (track != "noise" or k % 4 == 3)
            ]
            count = len(of.effects())
            assert len(set(singles[:count])) == count
        several = [len(forms) for forms in (_draw_forms("alien", 1, k, rng(k)) for k in range(7, 240, 8))]
        assert set(several) == {2, 3} and several.count(3) == len(several) // 3

    def test_severity_is_the_one_that_was_reached(self):
        case = draw_case("alien", 7000, 5)
        assert 0.3 < case.labels["effects"][0]["severity"] < 100

    def test_only_what_neither_timing_convention_explains_is_beyond_plays(self):
        """One delay within the hold of the tick before, and one of twelve ticks read before the write."""
        within, longer = draw_case("noise", 8004, 11), draw_case("alien", 8004, 5)
        assert (within.labels["timing"], longer.labels["timing"]) == ("end_of_hold", "before_write")
        (one,), (other,) = within.labels["effects"], longer.labels["effects"]
        assert one["name"] == other["name"] == "delay" and one["severity"] > 40
        assert one["severity_beyond_plays"] < 0.01
        assert other["severity_beyond_plays"] > 0.9 * other["severity"] > 20
