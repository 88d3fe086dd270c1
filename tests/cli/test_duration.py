"""Commands print how long they will take before they import anything heavy, from the size of their files."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from torchpi.cli import duration


@pytest.fixture(autouse=True)
def same_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(duration, "_pace", lambda: 1.0)
    monkeypatch.setattr(duration, "_compiled", lambda part: True)


def recording(path: Path, samples: int) -> Path:
    t = np.arange(samples) / 1e4
    np.savetxt(path, np.stack([t, t, t], 1), delimiter=",", header="time_s,input_v,output_um", comments="")
    return path


def seconds(text: str) -> float:
    found = re.fullmatch(r"This will take about (\d+) (s|min)\.\n", text)
    assert found, text
    return float(found[1]) * (60.0 if found[2] == "min" else 1.0)


@pytest.mark.parametrize("samples", [50, 20_000])
def test_samples_of_a_text_are_counted_by_its_first_lines(samples: int, tmp_path: Path) -> None:
    (found,) = duration._samples_in([recording(tmp_path / "a.csv", samples)])
    assert found == pytest.approx(samples, rel=0.05)


def test_a_file_that_cannot_be_read_counts_nothing(tmp_path: Path) -> None:
    (tmp_path / "empty.csv").touch()
    assert duration._samples_in([tmp_path / "none.csv", tmp_path / "empty.csv", tmp_path]) == [0, 0, 0]


def test_more_to_do_takes_longer(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    short, long = recording(tmp_path / "short.csv", 1_000), recording(tmp_path / "long.csv", 200_000)
    calls = [
        lambda files: duration.announce_check(files * 8),
        duration.announce_diagnose,
        lambda files: duration.announce_run([str(file) for file in files], 0),
        lambda files: duration.announce_fit(
            ["fit", "--config", "recorded", "--data.recordings", str([str(file) for file in files])]
        ),
    ]
    for announce in calls:
        printed = []
        for file in (short, long):
            announce([file])
            printed.append(seconds(capsys.readouterr().out))
        assert printed[0] < printed[1]


def test_epochs_and_simulated_recordings_of_a_config_count(capsys: pytest.CaptureFixture[str]) -> None:
    duration.announce_fit(["fit", "--config=demo", "--trainer.max_epochs=2"])
    few = seconds(capsys.readouterr().out)
    duration.announce_fit(["fit", "--config", "demo", "--trainer.max_epochs", "500"])
    assert few < seconds(capsys.readouterr().out)


@pytest.mark.parametrize(
    "arguments",
    [
        [], ["fit", "--help"], ["fit", "--config", "demo", "--print_config"], ["fit", "--config", "none"],
        ["fit", "--config", "demo", "--data.recordings", "{"], ["fit", "--data.recordings", "5"],
    ],
)  # fmt: skip
def test_nothing_is_printed_where_nothing_is_trained_or_understood(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    duration.announce_fit(arguments)
    assert capsys.readouterr().out == ""


def test_the_first_use_is_longer_and_a_slower_machine_too(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    duration.announce_diagnose(["none.csv"])
    usual = seconds(capsys.readouterr().out)
    monkeypatch.setattr(duration, "_pace", lambda: 3.0)
    duration.announce_diagnose(["none.csv"])
    assert seconds(capsys.readouterr().out) == pytest.approx(3 * usual, rel=0.5)
    monkeypatch.setattr(duration, "_compiled", lambda part: False)
    duration.announce_diagnose(["none.csv"])
    assert "most of it to compile, this once" in capsys.readouterr().out


@pytest.mark.parametrize(
    "command",
    [["check", "a.csv"], ["diagnose", "a.csv"], ["run", "a.pt"], ["train", "fit", "--config", "recorded"]],
)
def test_it_is_printed_before_torch_is_imported(command: list[str]) -> None:
    program = (
        "import sys\n"
        "from torchpi.cli import duration, main\n"
        "def announced(*_):\n"
        "    print('torch' in sys.modules)\n"
        "    sys.exit()\n"
        "duration._announce = announced\n"
        "main()\n"
    )
    done = subprocess.run([sys.executable, "-c", program, *command], capture_output=True, text=True)
    assert done.stdout == "False\n", done.stderr
