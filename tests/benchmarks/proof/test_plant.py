"""The published plant: its severities, its recordings, its conditions."""

import json
from dataclasses import replace

import numpy as np
import pytest
from concealed.cases import Case, write_case
from concealed.plant import blocks, excitation
from concealed.plant.case import Settings, draw_case
from concealed.plant.conditions import Conditions
from concealed.plant.effects import EFFECTS
from concealed.plant.hysteresis import draw_hysteresis
from concealed.plant.physics import Physics
from concealed.plant.rig import Rig, Run, simulate
from concealed.plant.severity import readings, severity
from concealed.plant.unknowns import UNKNOWNS

SAMPLES = 3000
FAMILIES = ("pi", "generalised_play", "preisach", "bouc_wen")
# What no small strength can undo: a mode of finite frequency, a delay of whole ticks.
NEVER_FAINT = {"resonance", "delay"}
FAINT_AT_THE_TOP = {"amplifier_lag", "slew_limit", "sensor_lag"}


@pytest.mark.parametrize(
    "name", ["creep", "amplifier_lag", "stiction", "hum", "incongruent_loops", "slew_limit"]
)
@pytest.mark.parametrize("wanted", [3.0, 12.0])
def test_severity_is_what_was_asked(name, wanted):
    case = _case(only=(name,), severity=wanted)
    (effect,) = case.labels["effects"]
    assert effect["severity"] == pytest.approx(wanted, rel=0.15)


def test_severity_is_the_rms_after_gain_and_offset_in_units_of_the_noise():
    rig, runs = _rig(), _runs()
    physics = Physics(a2_per_um=1e-3)
    without, with_effect = readings(rig, Physics(), runs), readings(rig, physics, runs)
    columns = np.column_stack([without, np.ones(without.size)])
    left = with_effect - columns @ np.linalg.lstsq(columns, with_effect, rcond=None)[0]
    assert severity(rig, physics, runs) == pytest.approx(np.sqrt(np.mean(left**2)) / rig.noise_um, rel=1e-6)


@pytest.mark.parametrize("name", sorted(EFFECTS.keys() - NEVER_FAINT))
def test_effects_vanish_at_their_weakest(name):
    rig, runs = _rig(), _runs()
    proposal = EFFECTS[name].propose(np.random.default_rng(2), rig, runs)
    weakest, strongest = proposal.low, proposal.high
    if name in FAINT_AT_THE_TOP:
        weakest, strongest = strongest, weakest
    faint = severity(rig, Physics(**proposal.change(weakest)), runs)
    strong = severity(rig, Physics(**proposal.change(strongest)), runs)
    assert faint < 0.2 < strong


@pytest.mark.parametrize("name", UNKNOWNS)
def test_what_is_outside_the_list_vanishes_too(name):
    rig, runs = _rig(), _runs()
    proposal = UNKNOWNS[name].proposal(np.random.default_rng(2), rig)
    assert severity(rig, Physics(**proposal.change(proposal.low)), runs) < 0.2


@pytest.mark.parametrize("kind", ["rich", "paper", "poor"])
def test_recordings_keep_the_contract(tmp_path, kind):
    settings = Settings("single_pi", 3, 4, kind, SAMPLES, only=("cross_coupling",))
    write_case(draw_case(settings), "case_0001", tmp_path)
    folder = tmp_path / "case_0001"
    assert sorted(p.name for p in folder.iterdir()) == ["a.csv", "b.csv", "c.csv", "heldout_input.csv"]
    labels = json.loads((tmp_path / "sealed" / "case_0001.json").read_text())
    for name in "abc":
        header = (folder / f"{name}.csv").read_text().splitlines()[0]
        table = np.loadtxt(folder / f"{name}.csv", delimiter=",", skiprows=1)
        assert header == "time_s,input_v,output_um,aux_v"
        assert np.all(np.isfinite(table)) and len(table) == SAMPLES
        np.testing.assert_allclose(np.diff(table[:, 0]), 1 / labels["fs_hz"], rtol=1e-3)
        assert table[0, 1] == pytest.approx(0, abs=0.02 * labels["upper_v"])
        assert labels["lower_v"] - 1e-6 <= table[:, 1].min() and table[:, 1].max() <= labels["upper_v"] + 1e-6
    assert (folder / "heldout_input.csv").read_text().startswith("time_s,input_v,aux_v\n")


def test_the_same_seed_gives_the_same_case_and_another_another():
    first, again, other = _case(index=1), _case(index=1), _case(index=2)
    np.testing.assert_array_equal(first.recordings[0]["output_um"], again.recordings[0]["output_um"])
    assert not np.array_equal(first.recordings[0]["output_um"], other.recordings[0]["output_um"])


@pytest.mark.parametrize("family", FAMILIES)
def test_truths_have_the_loop_they_were_drawn_with(family):
    hysteresis = draw_hysteresis(family, np.random.default_rng(5), 10.0, 20.0)
    leg = np.linspace(0, 10, 400)
    y = hysteresis.respond(np.concatenate([leg, leg[::-1], leg, leg[::-1]]))
    loop = np.max(y[1200:][::-1] - y[800:1200]) / np.ptp(y[800:])
    assert np.ptp(y[800:]) == pytest.approx(20.0, rel=0.02)
    assert 0.05 < loop < 0.16


@pytest.mark.parametrize("family", FAMILIES)
def test_truths_do_not_know_the_rate(family):
    hysteresis = draw_hysteresis(family, np.random.default_rng(6), 10.0, 20.0)
    corners = np.array([0.0, 7.0, 3.0, 9.0, 1.0, 5.0])
    fast = hysteresis.respond(corners)
    slow = hysteresis.respond(np.interp(np.linspace(0, 5, 5001), range(6), corners))
    np.testing.assert_allclose(slow[::1000], fast, atol=1e-3)


def test_preisach_wipes_out_and_its_minor_loops_differ_with_bias():
    hysteresis = draw_hysteresis("preisach", np.random.default_rng(7), 10.0, 20.0)
    direct = hysteresis.respond(np.array([0.0, 8.0]))[-1]
    by_way = hysteresis.respond(np.array([0.0, 5.0, 2.0, 4.0, 3.0, 8.0]))[-1]
    assert by_way == pytest.approx(direct, abs=1e-9)
    low, high = (
        y[3] - y[5]
        for y in (hysteresis.respond(np.array([0.0, v, v - 2, v - 1, v, v - 1, v - 2])) for v in (3.0, 9.0))
    )
    assert low < 0 and high < 0 and abs(high - low) > 0.03 * abs(low)


def test_mode_rings_at_its_frequency_with_its_damping():
    dt, f0, zeta = 1e-5, 400.0, 0.02
    x = blocks.mode(np.ones(20_000), f0, zeta, dt)
    t = dt * np.arange(1, x.size + 1)
    w, ring = 2 * np.pi * f0, np.sqrt(1 - zeta**2)
    exact = 1 - np.exp(-zeta * w * t) * (np.cos(w * ring * t) + zeta / ring * np.sin(w * ring * t))
    np.testing.assert_allclose(x, exact, atol=1e-6)


def test_a_reading_before_the_write_answers_the_command_of_the_tick_before():
    run = _runs()[0]
    late = simulate(_rig(timing="before_write"), Physics(), run)
    np.testing.assert_array_equal(late[1:], simulate(_rig(), Physics(), run)[:-1])


class TestSeverityBeyondPlays:
    """A delay of some ticks, on the same rig read at the end of the hold or before the write."""

    def effect(self, ticks: int, timing: str) -> dict:
        wanted = {1: 114.0, 2: 209.0, 3: 290.0}[ticks]  # that of a delay of so many ticks
        case = _case(only=("delay",), severity=wanted, timing=timing)
        (effect,) = case.labels["effects"]
        assert effect["parameters"]["delay_s"]["value"] * case.labels["fs_hz"] == pytest.approx(ticks)
        return effect

    def test_readings_that_are_late_by_the_other_timing_convention_are_no_effect(self):
        effect = self.effect(1, "end_of_hold")
        assert effect["severity"] > 100 and effect["severity_beyond_plays"] < 0.01

    def test_what_neither_convention_explains_is_kept(self):
        effect = self.effect(1, "before_write")
        assert effect["severity_beyond_plays"] > 0.9 * effect["severity"]

    def test_of_three_ticks_two_are_left_beside_the_other_convention(self):
        effect = self.effect(3, "end_of_hold")
        assert effect["severity_beyond_plays"] > 0.6 * effect["severity"] > 150
        two = self.effect(2, "before_write")["severity_beyond_plays"]
        assert effect["severity_beyond_plays"] == pytest.approx(two, rel=1e-3)


class TestConditions:
    def test_plain_conditions_leave_a_case_as_it_is(self):
        plain, same = _case(), _case(conditions=Conditions())
        for one, other in zip(plain.recordings, same.recordings, strict=True):
            np.testing.assert_array_equal(one["output_um"], other["output_um"])

    def test_a_remanent_start_moves_the_readings_and_not_the_command_or_the_heldout_record(self):
        plain, remanent = _null(), _null(remanent=True)
        for one, other in zip(plain.recordings, remanent.recordings, strict=True):
            np.testing.assert_array_equal(one["input_v"], other["input_v"])
            assert one["output_um"].shape == other["output_um"].shape
        first = [r["output_um"][0] for r in remanent.recordings]
        assert np.max(np.abs(first)) > 0.005 * plain.labels["range_um"]
        np.testing.assert_array_equal(plain.heldout["output_um"], remanent.heldout["output_um"])

    @pytest.mark.parametrize("family", FAMILIES)
    def test_a_history_is_played_before_the_first_reading(self, family):
        rig = replace(_rig(), hysteresis=draw_hysteresis(family, np.random.default_rng(5), 10.0, 10.0))
        history = np.interp(np.linspace(0, 1, 400), [0, 0.4, 0.7, 1], [0, 9, 2, 4.0])
        u = np.linspace(4.0, 8.0, 200)
        whole = simulate(rig, Physics(), Run(np.concatenate([history, u]), None, 0))
        run = Run(np.concatenate([history, u]), None, 0, history=history.size)
        np.testing.assert_array_equal(simulate(rig, Physics(), run), whole[history.size :])

    def test_without_holds_the_command_never_rests(self):
        for recording in _null(holds=False).recordings:
            rests = np.diff(recording["input_v"]) == 0
            assert np.convolve(rests, np.ones(8), "valid").max() < 8
            assert recording["input_v"][0] == 0
        held = [np.diff(r["input_v"]) == 0 for r in _null().recordings]
        assert max(np.convolve(rests, np.ones(8), "valid").max() for rests in held) == 8

    def test_a_monitored_voltage_is_near_the_command_and_the_readings_are_those_of_the_command(self):
        plain, monitored = _null(), _null(monitored=True)
        span = plain.labels["upper_v"] - plain.labels["lower_v"]
        for one, other in zip(plain.recordings, monitored.recordings, strict=True):
            np.testing.assert_array_equal(one["output_um"], other["output_um"])
            error = other["input_v"] - one["input_v"]
            assert 1e-5 * span < np.std(np.diff(error)) and np.max(np.abs(error)) < 0.02 * span
        assert np.any(monitored.heldout["input_v"] != plain.heldout["input_v"])

    @pytest.mark.parametrize("count", [1, 2, 4])
    def test_one_to_four_recordings_are_written_and_the_loaded_one_is_kept(self, tmp_path, count):
        around = Conditions(recordings=count)
        settings = Settings(
            "single_pi", 7, 0, samples=SAMPLES, only=("load_change", "resonance"), conditions=around
        )
        write_case(draw_case(settings), "case_0001", tmp_path)
        files = sorted(p.name for p in (tmp_path / "case_0001").glob("?.csv"))
        assert files == [f"{letter}.csv" for letter in "abcd"[:count]]
        labels = json.loads((tmp_path / "sealed" / "case_0001.json").read_text())
        seen = labels["effects"][0]["severity"] > 0.1
        assert seen == (count > 1)  # a load that never changes is a gain

    def test_other_units_scale_files_and_labels_alike(self):
        plain = _case(only=("sensor_nonlinearity",))
        scaled = _case(only=("sensor_nonlinearity",), conditions=Conditions(scale_v=10.0, scale_um=1e-3))
        for column, factor in (("input_v", 10.0), ("output_um", 1e-3)):
            np.testing.assert_allclose(scaled.heldout[column], factor * plain.heldout[column])
        (one,), (other,) = plain.labels["effects"], scaled.labels["effects"]
        assert one["severity"] == other["severity"]
        for name, parameter in one["parameters"].items():
            factor = {"1/um": 1e3, "1/um^2": 1e6}[parameter["unit"]]
            assert other["parameters"][name]["value"] == pytest.approx(factor * parameter["value"])
        assert scaled.labels["noise_rms_um"] == pytest.approx(1e-3 * plain.labels["noise_rms_um"])

    def test_nulls_under_conditions_are_a_third_of_each(self):
        conditions = [_case(track="nulls_conditions", index=i).labels["conditions"] for i in range(6)]
        assert [c["remanent"] for c in conditions] == [True, False, False] * 2
        assert [c["holds"] for c in conditions] == [True, False, True] * 2
        assert [c["monitored"] for c in conditions] == [False, False, True] * 2


def _case(track: str = "single_pi", index: int = 0, **settings: object) -> Case:
    return draw_case(Settings(track, 7, index, samples=SAMPLES, **settings))


def _null(**conditions: bool) -> Case:
    return _case(track="nulls_pi", index=1, conditions=Conditions(**conditions))


def _rig(timing: str = "end_of_hold") -> Rig:
    rng = np.random.default_rng(1)
    hysteresis = draw_hysteresis("pi", rng, 10.0, 10.0)
    other = draw_hysteresis("bouc_wen", rng, 10.0, 10.0)
    return Rig(hysteresis, other, 5000.0, 6, 0.0, 10.0, 10.0, 5e-3, "white", timing, 3)


def _runs() -> list[Run]:
    rng = np.random.default_rng(4)
    reach = excitation.Reach(0.0, 10.0, 5000.0, SAMPLES)
    commands = excitation.draw_recordings("rich", rng, reach)
    return [Run(u, excitation.draw_aux(rng, reach), i, i == 2) for i, u in enumerate(commands)]
