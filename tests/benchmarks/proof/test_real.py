"""Effects put into real recordings: exactly what the label says, and graded against the untouched answer."""

import ast
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks" / "real"))

import inject
import score
from injection import effects
from injection.case import EVERYWHERE, PLANS, SEVERITIES, draw_case
from injection.grade import grade
from injection.sources import Record, noise_of_periods
from injection.summary import summarise, table

REAL = Path(inject.__file__).parent
DATA = inject.DATA
with_data = pytest.mark.skipif(not DATA.is_dir(), reason="the real recordings are not here")
FS = 500.0
NOISE_UM = 0.01


def test_imports_nothing_of_torchpi():
    for file in REAL.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) else []
            assert not {name.split(".")[0] for name in names} & {"torchpi", "train", "torch"}, file


class TestEffects:
    def test_a_sensor_lag_turns_a_sine_by_the_phase_of_one_pole(self):
        t = np.arange(4000) / FS
        record = _record(np.sin(2 * np.pi * 5 * t))
        injection = effects.sensor_lag(_rng(), [record], NOISE_UM)
        strength = 3.0
        cutoff = injection.parameters(strength)["cutoff_hz"][0]
        (lagged,) = injection.inject(strength)
        answer = 1 / (1 + 5j / cutoff)
        exact = np.abs(answer) * np.sin(2 * np.pi * 5 * t + np.angle(answer))
        np.testing.assert_allclose(lagged.y[500:], exact[500:], atol=2e-3)

    @pytest.mark.parametrize("period", [None, 1000])
    def test_delays_of_sensor_and_command_are_the_same_shift(self, period):
        wave = np.tile(np.sin(2 * np.pi * np.arange(1000) / 1000), 2)
        record = replace(_record(wave), u=wave.copy(), period=period)
        (late,) = effects.delay_of_the_sensor(_rng(), [record], NOISE_UM).inject(3.0)
        (early,) = effects.delay_of_the_command(_rng(), [record], NOISE_UM).inject(3.0)
        np.testing.assert_allclose(late.y[3:], wave[:-3])
        np.testing.assert_allclose(early.u[: wave.size - 3], wave[3:])
        assert early.u.size == early.y.size

    def test_readings_before_the_first_sample_are_those_of_the_recording(self):
        whole = np.arange(100.0)
        record = replace(_record(whole[10:]), before=whole[:10])
        np.testing.assert_array_equal(record.read_late(4), whole[6:-4])
        np.testing.assert_array_equal(record.read_late(12)[:3], [0.0, 0.0, 0.0])

    def test_dropouts_are_single_readings(self):
        record = _record(1 + np.zeros(4000))
        for seed in range(4):
            injection = effects.dropouts(_rng(seed), [record], NOISE_UM)
            (injected,) = injection.inject(injection.start)
            changed = np.flatnonzero(injected.y != record.y)
            assert 3 <= changed.size <= 40 and changed[0] > 0

    def test_a_withheld_axis_is_not_in_the_files(self):
        record = replace(_record(np.zeros(10)), aux={"aux_2_v": np.ones(10), "aux_3_v": np.ones(10)})
        (injected,) = effects.withheld(_rng(), [record], NOISE_UM).inject(1.0)
        assert len(injected.aux) == 1

    def test_noise_of_periods_is_that_of_white_noise_on_a_wave(self):
        noise = NOISE_UM * _rng().standard_normal(20_000)
        wave = np.tile(np.sin(2 * np.pi * np.arange(1000) / 1000), 20)
        assert noise_of_periods(wave + noise, 1000) == pytest.approx(NOISE_UM, rel=0.03)

    @pytest.mark.parametrize("kind", sorted(EVERYWHERE))
    def test_every_effect_vanishes_with_its_strength(self, kind):
        wave = np.sin(2 * np.pi * np.arange(4000) / 500) + NOISE_UM * _rng().standard_normal(4000)
        injection = EVERYWHERE[kind](_rng(3), [_record(wave)], NOISE_UM)
        (faint,), (strong,) = injection.inject(injection.low), injection.inject(injection.high)
        assert np.std(faint.y - wave) < 1.5 * NOISE_UM < np.std(strong.y - wave)


@with_data
class TestCases:
    @pytest.mark.parametrize("kind", ["hum", "sensor_nonlinearity", "gain_multiplicative"])
    def test_the_severity_is_the_one_on_the_label(self, kind):
        index = _index(0, "stack_sine", kind)
        case = draw_case(DATA, 0, index)
        with_effect, without = (
            np.concatenate([r["output_um"] - r["output_um"].mean() for r in records])
            for records in (case.recordings, case.untouched_recordings)
        )
        gain = with_effect @ without / (without @ without)
        rms = np.sqrt(np.mean((with_effect - gain * without) ** 2))
        assert rms / case.labels["noise_rms_um"] == pytest.approx(case.labels["severity"], rel=1e-6)
        assert SEVERITIES[0] * 0.9 < case.labels["severity"] < SEVERITIES[1] * 1.1

    def test_a_seed_gives_the_same_files_again_and_both_folders_have_the_contract(self, tmp_path):
        number = _index(0, "stack_sine", "axis_recorded") + 1
        for folder in ("first", "again"):
            inject.write_case(DATA, 0, number, tmp_path / folder)
        files = sorted(p.relative_to(tmp_path / "first") for p in (tmp_path / "first").rglob("*.csv"))
        assert len(files) == 2
        for file in files:
            assert (tmp_path / "first" / file).read_bytes() == (tmp_path / "again" / file).read_bytes()
            assert (tmp_path / "first" / file).read_text().startswith("time_s,input_v,output_um,aux_v\n")

    def test_the_score_reads_the_answers_of_a_command(self, tmp_path, monkeypatch):
        number = _index(0, "stack_sine", "hum") + 1
        inject.write_case(DATA, 0, number, tmp_path / "cases")
        tool = tmp_path / "tool.py"
        tool.write_text(
            "import json, pathlib, sys\n"
            "out, names = pathlib.Path(sys.argv[2]), ['hum'] * ('case_' in sys.argv[1])\n"
            "effects = [{'name': n, 'probability': 0.9, 'share': 1.0} for n in names]\n"
            "rms = {'heldout_rms_um': 1.0}\n"
            "fit = {'retuned': rms, 'augmented': rms}\n"
            "answer = {'verdict': 'explained', 'effects': effects, 'fit': fit}\n"
            "(out / 'diagnosis.json').write_text(json.dumps(answer))\n"
        )
        arguments = [str(tmp_path / "cases"), "--answers", str(tmp_path / "answers")]
        command = f"{sys.executable} {tool} {{recordings}} {{out}}"
        monkeypatch.setattr(sys, "argv", ["score.py", *arguments, "--diagnose", command])
        score.main()
        results = json.loads((tmp_path / "answers" / "results.json").read_text())
        assert results["all"]["right_group"]["count"] == 1 and results["all"]["failed"] == 0

    def test_every_pair_of_recording_and_effect_is_drawn_once_a_seed(self):
        order = np.random.default_rng([5, 1]).permutation(len(PLANS))
        assert sorted(order) == list(range(len(PLANS)))


class TestGrade:
    def test_a_new_name_of_the_truth_is_right_and_exact(self):
        graded = grade(_labels("hum"), _answer("hum"), _answer())
        assert graded.outcome == "right" and graded.exact and not graded.wrong

    def test_a_name_that_cannot_be_split_from_the_truth_is_right_but_not_exact(self):
        graded = grade(_labels("sensor_lag", "amplifier_lag"), _answer("amplifier_lag"), _answer())
        assert graded.outcome == "right" and not graded.exact

    def test_the_truth_among_few_alternatives_is_right_and_among_many_is_not(self):
        few = _answer("sensor_lag", alternatives=["delay"])
        many = _answer("sensor_lag", alternatives=["delay", "creep", "hum", "leakage", "ageing"])
        assert grade(_labels("delay"), few, _answer()).outcome == "right"
        graded = grade(_labels("delay"), many, _answer())
        assert graded.outcome == "missed" and graded.wrong == ["sensor_lag"]

    def test_another_new_name_is_wrong_even_beside_the_right_one(self):
        graded = grade(_labels("hum"), _answer("hum", "creep"), _answer())
        assert graded.outcome == "right" and graded.wrong == ["creep"]

    def test_what_the_untouched_recording_has_is_neither_charged_nor_credited(self):
        graded = grade(_labels("hum"), _answer("creep"), _answer("creep"))
        assert graded.outcome == "missed" and not graded.wrong
        assert grade(_labels("hum"), _answer("hum"), _answer("hum")).outcome == "named_before"
        before = _answer("creep", alternatives=["thermal_drift"])
        assert not grade(_labels("hum"), _answer("thermal_drift"), before).wrong

    def test_another_name_of_a_group_is_new_only_where_the_first_is_still_there(self):
        before = _answer("hysteresis_operator")
        assert not grade(_labels("hum"), _answer("incongruent_loops"), before).wrong
        both = _answer("hysteresis_operator", "incongruent_loops")
        assert grade(_labels("hum"), both, before).wrong == ["incongruent_loops"]

    def test_a_name_that_was_there_and_grows_by_what_was_injected_is_right(self):
        labels = _labels("hum", severity=10.0)  # 0.1 µm
        grown = _answer("hum", retuned_um=0.3)
        assert grade(labels, grown, _answer("hum", retuned_um=0.28)).outcome == "right"
        assert grade(labels, grown, _answer("hum", retuned_um=0.295)).outcome == "named_before"

    def test_what_has_no_name_is_recognised_only_without_a_wrong_one(self):
        labels = _labels("cross_coupling") | {"accepted": []}
        assert grade(labels, _answer(verdict="unexplained"), _answer()).outcome == "recognised"
        assert grade(labels, _answer(verdict="explained"), _answer()).outcome == "overlooked"
        assert grade(labels, _answer("creep", verdict="unexplained"), _answer()).outcome == "overlooked"

    def test_a_failure_misses_and_charges_nothing(self):
        graded = grade(_labels("hum"), None, _answer())
        assert graded.outcome == "missed" and graded.verdict == "failed" and not graded.wrong

    def test_parameters_of_a_new_exact_name_are_compared(self):
        labels = _labels("hum") | {"parameters": {"mains_hz": {"value": 50.0, "unit": "Hz"}}}
        answer = _answer("hum")
        answer["effects"][0]["parameters"] = {
            "frequency": {"value": 51.0, "unit": "Hz", "interval_90": [49.0, 52.0]}
        }
        (row,) = grade(labels, answer, _answer()).parameters
        assert row["relative_error"] == pytest.approx(0.02) and row["covered"]

    def test_the_summary_counts_right_missed_and_wrong(self):
        grades = [
            grade(_labels("hum"), _answer("hum"), _answer()),
            grade(_labels("hum"), _answer("creep"), _answer()),
            grade(_labels("hum"), _answer("hum"), _answer("hum")),
        ]
        summary = summarise(grades, {"x/untouched_a": _answer("creep")})
        assert summary["all"]["right_group"]["count"] == 1 and summary["all"]["right_group"]["of"] == 2
        assert summary["all"]["wrong_names"]["share"] == 0.5 and summary["all"]["named_before"] == 1
        assert "50 % (1/2)" in table(summary) and "creep (0.90)" in table(summary)


def test_help_is_printed():
    for script in ("inject.py", "score.py"):
        done = subprocess.run([sys.executable, str(REAL / script), "--help"], capture_output=True, text=True)
        assert done.returncode == 0 and "usage" in done.stdout


def _rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def _record(y: np.ndarray) -> Record:
    return Record(np.zeros(y.size), y, {}, FS, None, y[:0])


def _index(seed: int, source: str, kind: str) -> int:
    order = np.random.default_rng([seed, 1]).permutation(len(PLANS))
    return order.tolist().index(PLANS.index((source, kind)))


def _labels(name: str, *also: str, severity: float = 5.0) -> dict:
    return {
        "case": "case_0001",
        "source": "stack_sine",
        "kind": name,
        "name": name,
        "accepted": [name, *also],
        "severity": severity,
        "noise_rms_um": NOISE_UM,
        "parameters": {},
    }


def _answer(
    *names: str,
    verdict: str = "partly_explained",
    alternatives: list[str] | None = None,
    retuned_um: float = 0.3,
) -> dict:
    effects = [
        {"name": name, "probability": 0.9, "share": 1.0, "alternatives": alternatives or []} for name in names
    ]
    fit = {
        "retuned": {"heldout_rms_um": retuned_um},
        "augmented": {"heldout_rms_um": 0.05},
        "noise_floor_um": None,
    }
    return {"verdict": verdict, "effects": effects, "fit": fit}
