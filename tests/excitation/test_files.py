"""`torchpi excite` writes files that are read back bit for bit, or prints one line and writes nothing."""

import sys
from pathlib import Path

import numpy as np
import pytest

from torchpi.cli import commands
from torchpi.excitation.files import INSTRUCTIONS
from torchpi.excitation.limits import DriveLimits
from torchpi.excitation.sets import diagnostic_excitations
from torchpi.recordings.signal import read_signal

LIMITS = ["--max_voltage_v", "7.5", "--min_voltage_v", "-1", "--max_rate_v_s", "1500"]
LIMITS += ["--sample_rate_hz", "1000", "--high_hz", "100", "--seed", "3"]


def excite(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["torchpi", "excite", *arguments])
    with pytest.raises(SystemExit) as ended:
        commands.main()
    return int(ended.value.code or 0)


def test_the_files_hold_the_set_in_playing_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert excite(monkeypatch, "--for", "diagnosis", "--output", str(tmp_path / "e"), *LIMITS) == 0
    made = diagnostic_excitations(DriveLimits(-1, 7.5, 1500, 1000, 100), seed=3)
    files = sorted((tmp_path / "e").glob("*.csv"))
    assert [path.stem for path in files] == [f"{k}_{name}" for k, name in enumerate(made, 1)]
    for path, (t, u) in zip(files, made.values(), strict=True):
        assert path.read_text().startswith("time_s,input_v\n0.0,0.0\n")
        signal = read_signal(path, "input_v", unit="V")
        assert signal.fs_hz == pytest.approx(1000, rel=1e-9)
        np.testing.assert_array_equal(signal.x, u)
        np.testing.assert_array_equal(signal.t, t)
    printed, kept = capsys.readouterr().out, (tmp_path / "e" / INSTRUCTIONS).read_text()
    for text in (printed, kept):
        assert all(path.name in text for path in files)
        assert "ten minutes" in text and "time_s,input_v,output_um" in text and "torchpi diagnose" in text


def test_the_default_purpose_is_diagnosis_and_files_are_reproducible(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    excite(monkeypatch, "--output", str(tmp_path / "a"), *LIMITS)
    excite(monkeypatch, "--for", "diagnosis", "--output", str(tmp_path / "b"), *LIMITS)
    for path in (tmp_path / "a").glob("*.csv"):
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()


def test_help_lists_the_option_for_and_an_example(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert excite(monkeypatch, "--help") == 0
    text = capsys.readouterr().out
    assert "--for FOR " in text and "for_" not in text.lower()
    assert "Example: torchpi excite --for diagnosis" in text


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--for", "training"], "--for: found 'training', expected diagnosis"),
        (["--fro", "diagnosis"], "nearest is 'for'"),
        (["--for_", "diagnosis"], "nearest is 'for'"),
        (["--max_rate_v_s", "20"], "max_rate_v_s is 20 V/s, expected"),
        (["--high_hz", "4000"], "sample_rate_hz is 10000 Hz, expected 16000 Hz"),
        (["--min_voltage_v", "2"], "min_voltage_v is 2 V"),
        (["--output", "taken"], "taken is a file, expected a folder"),
    ],
)
def test_invalid_arguments_give_one_line_and_nothing_is_written(
    arguments: list[str],
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").write_text("a file")
    assert excite(monkeypatch, *arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("torchpi: error: ") and error.count("\n") == 1 and says in error
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]
