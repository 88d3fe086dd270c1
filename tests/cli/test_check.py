"""`torchpi check` describes a file before anything is fitted and prints commands ready to paste."""

import re
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest

from torchpi.cli import commands
from torchpi.cli.check import commands_for
from torchpi.errors import RecordingError
from torchpi.excitation.signals import hold, multisine, sine_5hz, stairs
from torchpi.recordings.faults import noise_estimate
from torchpi.recordings.recording import RecordingOptions, read_recording
from torchpi.recordings.summary import comes_back, holds_of, summarise

FS_HZ = 1000.0
T = np.arange(2000) / FS_HZ
U = 5 - 5 * np.cos(2 * np.pi * 2.5 * T)
Y = 0.8 * U + 0.1 * np.roll(U, 20)


def write(path: Path, header: str, *columns: np.ndarray, delimiter: str = ",") -> Path:
    np.savetxt(path, np.stack(columns, 1), "%.9g", delimiter, header=header, comments="")
    return path


def check(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["torchpi", "check", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        commands.main()
    return int(ended.value.code or 0)


def test_the_content_of_a_file_is_printed_and_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    y = Y.copy()
    y[700] = 0.0
    path = write(tmp_path / "rig.csv", "time_ms,u [mV],output (nm),note", 1e3 * T, 1e3 * U, 1e3 * y, 0 * T)
    assert check(monkeypatch, path, "--output", tmp_path / "out") == 0
    text = capsys.readouterr().out
    for found in (
        "u [mV]",
        "mV",
        "1000 Hz, 2,000 samples, 2 s",
        "0 … 10 V",
        "sign positive",
        "noise-free",
        "1 single wrong",
        "row 702: 0 µm",
        "time 'time_ms' (s)",
    ):
        assert found in text
    page = (tmp_path / "out" / "check.html").read_text(encoding="utf-8")
    assert "<svg" in page and "row 702" in page and "torchpi diagnose" in page
    answer = page[page.index('<p class="answer"') : page.index("<figure")]
    assert "Usable, with a warning" in answer and "row 702" in answer and "1,000 Hz, 2 s" in answer


@pytest.mark.parametrize(
    ("header", "scale"),
    [("time_s,input_v,output_um", (1, 1, 1)), ("t;my input;my output", (1, 1, 1)), ("a,b,c", (1, 1, 1))],
)
def test_the_printed_commands_read_the_file(
    tmp_path: Path,
    header: str,
    scale: tuple[float, ...],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    delimiter = ";" if ";" in header else ","
    table = [x / factor for x, factor in zip((T, U, Y), scale, strict=True)]
    path = write(tmp_path / "with space.csv", header, *table, delimiter=delimiter)
    assert check(monkeypatch, path, "--output", tmp_path / "out") == 0
    lines = capsys.readouterr().out.splitlines()
    (diagnose,) = (shlex.split(line) for line in lines if line.startswith("torchpi diagnose"))
    assert diagnose[2] == str(path)
    seen: dict[str, object] = {}
    monkeypatch.setattr("torchpi.cli.diagnose.diagnose_files", lambda *given: seen.update(options=given[-1]))
    monkeypatch.setattr(sys, "argv", diagnose)
    with pytest.raises(SystemExit):
        commands.main()
    options = seen["options"]
    assert isinstance(options, RecordingOptions)
    np.testing.assert_allclose(read_recording(path, options).y, Y, atol=1e-6)


def test_files_that_need_different_options_get_separate_commands(tmp_path: Path) -> None:
    first = summarise(write(tmp_path / "a.csv", "time_s,input_v,output_um", T, U, Y))
    second = summarise(write(tmp_path / "b.csv", "time_s,x1,x2", T, U, Y))
    assert len(commands_for([first, first])) == 2
    fit, diagnose, other_fit, other = commands_for([first, second])
    assert "--input_column x1 --output_column x2" in other and "--data.input_column x1" in other_fit
    assert "column" not in fit + diagnose


def test_a_bad_file_gives_one_error_line_and_the_others_are_described(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    good = write(tmp_path / "good.csv", "time_s,input_v,output_um", T, U, Y)
    flat = write(tmp_path / "flat.csv", "time_s,input_v,output_um", T, U, 0 * Y)
    missing = tmp_path / "missing.csv"
    assert check(monkeypatch, missing, flat, good, "--output", tmp_path / "out") == 2
    printed = capsys.readouterr()
    assert re.fullmatch(r"torchpi: error: .*missing\.csv: .*\ntorchpi: error: .*flat\.csv: .*\n", printed.err)
    assert "good.csv" in printed.out
    page = (tmp_path / "out" / "check.html").read_text(encoding="utf-8")
    assert "<strong>2 of 3 cannot be used</strong>" in page and "missing.csv" in page


def test_nothing_is_written_if_no_file_is_usable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.csv").write_text("what is this\n" * 30)
    assert check(monkeypatch, tmp_path / "a.csv", "--output", tmp_path / "out") == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_an_output_that_is_a_file_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path / "a.csv", "time_s,input_v,output_um", T, U, Y)
    assert check(monkeypatch, path, "--output", path) == 2
    assert "is a file, expected a folder" in capsys.readouterr().err


def test_uneven_sampling_is_measured_and_the_resample_option_is_given(tmp_path: Path) -> None:
    t = T + 2e-4 * np.random.default_rng(0).random(len(T))
    summary = summarise(write(tmp_path / "a.csv", "time_s,input_v,output_um", t, U, Y))
    assert summary.options.resample and summary.jitter == pytest.approx(0.2, abs=0.03)
    assert "--resample true" in commands_for([summary])[1]
    even = summarise(write(tmp_path / "b.csv", "time_s,input_v,output_um", T, U, Y))
    assert not even.options.resample and even.jitter is not None and even.jitter < 1e-6


def test_columns_that_cannot_be_identified_are_left_to_the_user(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "time_s,x1,x2,x3", T, U, Y, U + Y)
    with pytest.raises(RecordingError, match="no column 'input_v'"):
        summarise(path)
    assert not summarise(path, RecordingOptions(input_column="x1", output_column="x3")).guessed


@pytest.mark.parametrize("noise_v", [0.0, 1e-3])
def test_holds_are_counted_in_commanded_and_monitored_voltages(noise_v: float) -> None:
    _, still = hold(0.4)
    t, climbing = sine_5hz(0.4)
    u = np.concatenate([np.full(4000, 1.0), 1.0 + climbing, np.full(6000, 3.0)])
    u = u + noise_v * np.random.default_rng(1).standard_normal(len(u))
    fs_hz = 1 / (t[1] - t[0])
    found = holds_of(u, fs_hz, noise_estimate(u))
    assert found.count >= 2
    assert found.longest_s == pytest.approx(6000 / fs_hz, rel=0.05)
    assert holds_of(still, fs_hz, 0.0).share > 0.8


@pytest.mark.parametrize("sigma", [1e-3, 0.02])
@pytest.mark.parametrize("make", [sine_5hz, stairs, multisine])
def test_the_noise_is_estimated_in_the_presence_of_motion(make: object, sigma: float) -> None:
    u = make(1.0)[1]
    y = 0.8 * u + sigma * np.random.default_rng(2).standard_normal(len(u))
    assert noise_estimate(y) == pytest.approx(sigma, rel=0.05)


def test_remanence_at_the_start_is_distinguished_from_a_start_on_the_loop() -> None:
    u = 5 - 5 * np.cos(2 * np.pi * 5 * np.arange(4000) / 4000)
    play = np.empty_like(u)
    state = 0.0
    for k, x in enumerate(u):
        state = max(x - 0.7, min(x + 0.7, state))
        play[k] = state
    assert comes_back(u, play) == pytest.approx(0.7, abs=0.02)
    assert comes_back(u[800:], play[800:]) == pytest.approx(0, abs=0.02)
    assert comes_back(np.arange(100.0), np.arange(100.0)) is None
    assert comes_back(np.ones(100), np.arange(100.0)) is None


@pytest.mark.parametrize(
    ("sign", "found"), [(1.0, "µm higher: the remanence"), (-1.0, "µm lower: the remanence")]
)
def test_remanence_is_reported_for_either_orientation_of_the_sensor(
    sign: float,
    found: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    y, state = np.empty_like(U), 0.0
    for k, x in enumerate(U):
        state = max(x - 0.7, min(x + 0.7, state))
        y[k] = state
    path = write(tmp_path / "a.csv", "time_s,input_v,output_um", T, U, sign * y)
    assert check(monkeypatch, path, "--output", tmp_path / "page") == 0
    assert found in capsys.readouterr().out
