"""`torchpi check` of several axes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.stage.two_axes import recordings, two_axes
from torchpi.cli.commands import check
from torchpi.errors import RecordingError
from torchpi.recordings.multi_axis import MultiAxisRecording, write_multi_axis


def written(folder: Path, *every: MultiAxisRecording) -> list[Path]:
    paths = [folder / f"run{number}.csv" for number in range(len(every))]
    for path, one in zip(paths, every, strict=True):
        write_multi_axis(path, one)
    return paths


def test_columns_periods_and_the_next_command_are_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = recordings(two_axes(), (0.3,), 1)[0]
    random = np.random.default_rng(0).standard_normal(one.u.shape)
    paths = written(tmp_path, one, replace(one, u=random))
    check(paths, tmp_path / "check")
    printed = capsys.readouterr().out
    assert "input_2_v" in printed and "2 inputs (V), 2 outputs (µm)" in printed
    assert "2 of 512 samples; treated as the steady state" in printed
    assert "the inputs are not periodic, so the recording is fitted in the time domain" in printed
    assert f"torchpi diagnose {paths[0]} {paths[1]}" in printed
    assert "output 2" in (tmp_path / "check" / "check.html").read_text()


def test_a_constant_input_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one = recordings(two_axes(), (0.3,), 1)[0]
    check(written(tmp_path, replace(one, u=one.u * [1.0, 0.0])), tmp_path / "check")
    printed = capsys.readouterr().out
    assert "input 2     0 V throughout" in printed
    assert "warning     input_2_v: found the same value throughout, so left out" in printed


def test_files_of_different_stages_and_proportional_inputs_are_refused(tmp_path: Path) -> None:
    one = recordings(two_axes(), (0.3,), 1)[0]
    with pytest.raises(RecordingError, match=r"run1: found 1 inputs and 2 outputs .* expected 2, 2"):
        check(written(tmp_path, one, replace(one, u=one.u[:, :1])), tmp_path / "check")
    with pytest.raises(RecordingError, match="found inputs that always move in proportion"):
        check(written(tmp_path, replace(one, u=one.u[:, [0, 0]])), tmp_path / "check")
