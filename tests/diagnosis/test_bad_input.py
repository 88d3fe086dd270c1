"""Invalid recordings are refused in one line; what valid ones cannot show is stated with the result."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.diagnosis.plants import FS_HZ, multisine, pair, record, stairs
from torchpi.cli import commands
from torchpi.diagnosis.diagnose import diagnose
from torchpi.errors import RecordingError
from torchpi.recordings.recording import Recording, write_recording


def refused(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Return the single line with which the command refuses its arguments."""
    monkeypatch.setattr(sys, "argv", ["torchpi", "diagnose", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        commands.main()
    assert ended.value.code == 2
    message = capsys.readouterr().err.strip()
    assert "\n" not in message and "Traceback" not in message
    return message


def written(folder: Path, *recordings: Recording) -> list[Path]:
    for one in recordings:
        write_recording(folder / f"{one.name}.csv", one)
    return [folder / f"{one.name}.csv" for one in recordings]


def test_columns_that_differ_between_files_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = pair(400)
    files = written(tmp_path, replace(first, aux={"aux_2": first.u}), second)
    line = refused(monkeypatch, capsys, *files, "--output", tmp_path / "out")
    assert "aux_2" in line and "leave out" in line
    assert not (tmp_path / "out").exists()


def test_a_simulation_in_other_units_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    files = written(tmp_path, *pair(400))
    in_nanometres = {
        "sample_rate_hz": 2000,
        "actuator": {"thresholds_v": [0, 1, 2], "weights_um_per_v": [500, 200, 200]},
    }
    (tmp_path / "nm.yaml").write_text(yaml.safe_dump(in_nanometres), encoding="utf-8")
    line = refused(
        monkeypatch, capsys, *files, "--simulation", tmp_path / "nm.yaml", "--output", tmp_path / "o"
    )
    assert "simulation" in line and "V and µm" in line


def test_a_recording_at_constant_voltage_alone_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    files = written(tmp_path, record(np.full(400, 3.0), name="hold"))
    assert "input never changes" in refused(monkeypatch, capsys, *files, "--output", tmp_path / "out")


@pytest.mark.parametrize(
    ("option", "value", "word"),
    [
        ("--executor", "cluster", "cluster"),
        ("--inputcolumn", "u", "nearest is 'input_column'"),
        ("--simulation", "no.yaml", "no.yaml"),
    ],
)
def test_invalid_options_are_refused(
    option: str,
    value: str,
    word: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    files = written(tmp_path, *pair(400))
    assert word in refused(monkeypatch, capsys, *files, option, value, "--output", tmp_path / "out")


def test_missing_recordings_too_few_samples_and_nan_are_refused() -> None:
    with pytest.raises(RecordingError, match="found none"):
        diagnose([])
    with pytest.raises(RecordingError, match="found 50 samples, expected at least 100"):
        diagnose([record(multisine(50))])
    one = record(multisine(400))
    one.y[7] = np.nan
    with pytest.raises(RecordingError, match="output is nan at sample 7"):
        diagnose([one])


@pytest.mark.parametrize(("gain", "comparison"), [(0.8, "smaller"), (1.2, "larger")])
def test_recordings_of_different_stages_are_reported_as_conflicting(gain: float, comparison: str) -> None:
    """A different gain may also come from a changed load on the same stage, which is the effect named."""
    first, second = pair(2000)
    third = record(multisine(2000, seed=5), name="third", seed=5)
    found = diagnose([first, second, replace(third, y=gain * third.y + 0.5)])
    assert any(note.startswith(f"Recording third needs a {comparison} gain") for note in found.notes)
    assert [effect.name for effect in found.effects] == ["load_change"]
    assert found.effects[0].parameters[0].value == pytest.approx(1 / gain - 1, rel=0.02)


def test_a_gain_that_no_load_explains_is_reported_as_another_stage_or_gain_modulation() -> None:
    first, second = pair(2000)
    third = record(multisine(2000, seed=5), name="third", seed=5)
    found = diagnose([first, second, replace(third, y=2.5 * third.y)])
    conflict = next(note for note in found.notes if note.startswith("Recording third needs"))
    # The only effect on the list for this is a gain that wanders in each recording.
    assert "another stage" in conflict or "gain_modulation" in {effect.name for effect in found.effects}


def test_a_single_recording_is_allowed_and_its_limits_are_stated() -> None:
    found = diagnose([record(multisine(1500))])
    assert any(note.startswith("There is only one recording") for note in found.notes)
    assert any(note.startswith("load_change: left out") for note in found.notes)


def test_a_recording_without_reversals_is_allowed_and_its_limits_are_stated() -> None:
    found = diagnose([record(np.linspace(0, 10, 1500))])
    assert any("never reverses: hysteresis cannot be seen" in note for note in found.notes)
    assert any(note.startswith("backlash: left out, the voltage never reverses") for note in found.notes)


def test_a_constant_voltage_among_other_recordings_is_noted_and_yields_the_noise_floor() -> None:
    resting = record(np.full(800, 3.0), name="resting", noise_um=0.01)
    found = diagnose([record(multisine(1500), noise_um=0.01), resting])
    assert any(note.startswith("The voltage is constant in resting") for note in found.notes)
    assert found.noise_floor_um == pytest.approx(0.01, rel=0.25)


def test_effects_that_one_recording_cannot_show_are_left_out_but_slow_effects_are_not() -> None:
    found = diagnose([record(multisine(400))])
    left_out = {note.split(":")[0] for note in found.notes if ": left out, " in note}
    assert {"load_change", "cross_coupling"} <= left_out
    assert left_out.isdisjoint({"creep", "leakage", "thermal_drift", "ageing"})
    # With 400 samples the fitted hysteresis has few plays, whereas the rig has 60.
    assert {effect.name for effect in found.effects} <= {"hysteresis_operator"}


def test_no_slow_effect_slew_limit_or_backlash_is_left_out_for_long_stairs() -> None:
    """The steps are too rare to show in any percentile of the rate, and the holds between them are long."""
    found = diagnose([record(stairs(5000, 4))])
    left_out = {note.split(":")[0] for note in found.notes if ": left out, " in note}
    assert left_out.isdisjoint({"creep", "leakage", "thermal_drift", "slew_limit", "backlash"})


def test_a_constant_column_is_reported() -> None:
    found = diagnose([record(multisine(1000), aux={"aux_still": np.zeros(1000)})])
    assert any("Constant in all recordings: aux_still" in note for note in found.notes)
    assert FS_HZ == found.traces[0].fs_hz
