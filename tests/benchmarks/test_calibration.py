"""Calibration of stated probabilities: the scores of tools whose calibration is known."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import calibration


def test_a_tool_that_is_right_as_often_as_it_states_has_no_more_error_than_chance():
    rng = np.random.default_rng(1)
    probabilities = rng.uniform(0, 1, 4000)
    figures = calibration.reliability(probabilities, rng.random(4000) < probabilities)
    assert figures["expected_calibration_error"] < figures["by_chance"]["below"] < 0.03
    assert figures["brier"] == pytest.approx(1 / 6, abs=0.01)


def test_a_tool_that_is_too_sure_has_the_excess_as_its_error():
    right = np.arange(1000) % 10 < 7
    figures = calibration.reliability(np.full(1000, 0.95), right)
    assert figures["expected_calibration_error"] == pytest.approx(0.25)
    assert figures["expected_calibration_error"] > 5 * figures["by_chance"]["below"]
    (only,) = figures["bins"]
    assert only["at_least"] < 0.7 < only["at_most"] < 0.95


def test_tolerated_names_and_faint_intervals_are_left_out():
    cases = [_case(0.9, True, covered=True), _case(0.8, None, covered=False, severity=1.0)]
    figures = calibration.calibration(cases)
    assert figures["names"] == 1 and figures["tolerated"] == 1
    assert figures["interval_coverage"]["count"] == figures["interval_coverage"]["of"] == 1


def test_folders_of_graded_answers_become_a_figure_and_json(tmp_path, monkeypatch, capsys):
    for track in ("a", "b"):
        (tmp_path / track).mkdir()
        (tmp_path / track / "results.json").write_text(
            json.dumps({"cases": [_case(0.9, True, covered=True)]})
        )
    arguments = [str(tmp_path / "a"), str(tmp_path / "b"), "--output", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", ["calibration.py", *arguments])
    calibration.main()
    assert json.loads((tmp_path / "out" / "calibration.json").read_text())["names"] == 2
    assert (tmp_path / "out" / "calibration.png").stat().st_size > 0
    assert "cover 2 of 2" in capsys.readouterr().out


def _case(probability: float, right: bool | None, *, covered: bool, severity: float = 5.0) -> dict:
    stated = {"name": "hum", "probability": probability, "right": right, "right_group": right}
    return {"stated": [stated], "parameters": [{"covered": covered, "severity": severity}]}
