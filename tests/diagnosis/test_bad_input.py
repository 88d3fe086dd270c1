"""What is wrong with recordings is said in one line; what they cannot show is said beside what they show."""

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
    """The one line with which the command refuses."""
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
        "sample_rate_hz": 2000, "actuator": {"thresholds_v": [0, 1, 2], "weights_um_per_v": [500, 200, 200]}
    }  # fmt: skip
    (tmp_path / "nm.yaml").write_text(yaml.safe_dump(in_nanometres), encoding="utf-8")
    line = refused(
        monkeypatch, capsys, *files, "--simulation", tmp_path / "nm.yaml", "--output", tmp_path / "o"
    )
    assert "simulation" in line and "V and µm" in line


def test_a_hold_alone_is_refused(
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
def test_options_that_cannot_be_are_refused(
    option: str, value: str, word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    files = written(tmp_path, *pair(400))
    assert word in refused(monkeypatch, capsys, *files, option, value, "--output", tmp_path / "out")


def test_no_recordings_too_few_samples_and_holes_are_refused() -> None:
    with pytest.raises(RecordingError, match="found none"):
        diagnose([])
    with pytest.raises(RecordingError, match="found 50 samples, expected at least 100"):
        diagnose([record(multisine(50))])
    one = record(multisine(400))
    one.y[7] = np.nan
    with pytest.raises(RecordingError, match="output is nan at sample 7"):
        diagnose([one])


@pytest.mark.parametrize(("gain", "comparison"), [(0.8, "smaller"), (1.2, "larger")])
def test_recordings_of_different_stages_are_said_to_conflict(gain: float, comparison: str) -> None:
    """A stage of another gain may as well be the same one under a load, or without one: that is named."""
    first, second = pair(2000)
    third = record(multisine(2000, seed=5), name="third", seed=5)
    found = diagnose([first, second, replace(third, y=gain * third.y + 0.5)])
    assert any(note.startswith(f"Recording third needs a {comparison} gain") for note in found.notes)
    assert [effect.name for effect in found.effects] == ["load_change"]
    assert found.effects[0].parameters[0].value == pytest.approx(1 / gain - 1, rel=0.02)


def test_recordings_that_no_load_explains_are_said_to_be_of_another_stage() -> None:
    first, second = pair(2000)
    third = record(multisine(2000, seed=5), name="third", seed=5)
    found = diagnose([first, second, replace(third, y=2.5 * third.y)])
    conflict = next(note for note in found.notes if note.startswith("Recording third needs"))
    # A gain of its own that wanders is what the list has for it.
    assert "another stage" in conflict or "gain_modulation" in {effect.name for effect in found.effects}


def test_one_recording_is_allowed_and_its_limits_are_said() -> None:
    found = diagnose([record(multisine(1500))])
    assert any(note.startswith("There is only one recording") for note in found.notes)
    assert any(note.startswith("load_change: left out") for note in found.notes)


def test_a_record_that_never_turns_round_is_allowed_and_its_limits_are_said() -> None:
    found = diagnose([record(np.linspace(0, 10, 1500))])
    assert any("never reverses: hysteresis cannot be seen" in note for note in found.notes)
    assert any(note.startswith("backlash: left out, the voltage never reverses") for note in found.notes)


def test_a_hold_among_others_serves_for_what_it_shows() -> None:
    resting = record(np.full(800, 3.0), name="resting", noise_um=0.01)
    found = diagnose([record(multisine(1500), noise_um=0.01), resting])
    assert any(note.startswith("The voltage is constant in resting") for note in found.notes)
    assert found.noise_floor_um == pytest.approx(0.01, rel=0.25)


def test_what_one_record_cannot_show_is_left_out_and_said_and_nothing_slow_for_its_length() -> None:
    found = diagnose([record(multisine(400))])
    left_out = {note.split(":")[0] for note in found.notes if ": left out, " in note}
    assert {"load_change", "cross_coupling"} <= left_out
    assert left_out.isdisjoint({"creep", "leakage", "thermal_drift", "ageing"})
    # Of 400 samples the plays of the simulation are few, and the rig has 60.
    assert {effect.name for effect in found.effects} <= {"hysteresis_operator"}


def test_long_stairs_leave_nothing_slow_out() -> None:
    """Steps so rare that no percentile of the rate sees them, and holds of seconds."""
    found = diagnose([record(stairs(5000, 4))])
    left_out = {note.split(":")[0] for note in found.notes if ": left out, " in note}
    assert left_out.isdisjoint({"creep", "leakage", "thermal_drift", "slew_limit", "backlash"})


def test_a_column_in_which_nothing_moves_is_said() -> None:
    found = diagnose([record(multisine(1000), aux={"aux_still": np.zeros(1000)})])
    assert any("Constant in all recordings: aux_still" in note for note in found.notes)
    assert FS_HZ == found.traces[0].fs_hz
