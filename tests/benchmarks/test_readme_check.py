"""The check of the README's diagnosis: it finds the command lines and reports wrong answers."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import readme_check


def test_the_readme_simulates_four_recordings_and_diagnoses_any_of_them():
    simulate, diagnose = readme_check.readme_lines(readme_check.README.read_text(encoding="utf-8"))
    assert len(simulate) == 4 and all(words[0] == "simulate" for words in simulate)
    words = readme_check.with_recordings(diagnose, ["a.csv"], "answer")
    assert words[:2] == ["diagnose", "a.csv"] and words[words.index("--output") + 1] == "answer"
    assert sum(word.endswith(".csv") for word in words) == 1


def test_a_readme_without_the_commands_is_refused():
    with pytest.raises(ValueError, match="found 0 of simulate"):
        readme_check.readme_lines("```sh\nmake demo\n```")


def test_a_diagnosis_of_all_recordings_must_name_mode_creep_and_a_lag_or_delay():
    complete = [_effect("resonance"), _effect("creep"), _effect("sensor_lag", "delay")]
    assert readme_check.faults({"verdict": "explained", "effects": complete}, True) == []
    (fault,) = readme_check.faults({"verdict": "explained", "effects": complete[:2]}, True)
    assert "found creep, resonance, expected amplifier_lag or delay or sensor_lag" in fault


def test_a_diagnosis_of_fewer_recordings_must_only_find_something_missing():
    assert readme_check.faults({"verdict": "unexplained", "effects": []}, False) == []
    assert len(readme_check.faults({"verdict": "nothing_missing", "effects": []}, False)) == 1


def test_the_line_shows_names_with_probabilities_and_alternatives():
    diagnosis = {"verdict": "explained", "effects": [_effect("creep"), _effect("sensor_lag", "delay")]}
    assert readme_check.line(diagnosis) == "explained: creep 0.80; sensor_lag 0.80 (or delay)"


def _effect(name: str, *alternatives: str) -> dict:
    return {"name": name, "probability": 0.8, "alternatives": list(alternatives)}
