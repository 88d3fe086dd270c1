"""Commands announce their duration, estimated from file sizes, before they import anything heavy."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from torchpi.cli import duration, machine
from torchpi.cli.machine import Machine
from torchpi.diagnosis import long_recordings


@pytest.fixture(autouse=True)
def same_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(duration, "measured", lambda processes: Machine(1.0, 1.0, float(processes)))
    monkeypatch.setattr(duration, "_compiled", lambda part: True)


def recording(path: Path, samples: int) -> Path:
    t = np.arange(samples) / 1e4
    np.savetxt(path, np.stack([t, t, t], 1), delimiter=",", header="time_s,input_v,output_um", comments="")
    return path


def seconds(text: str) -> float:
    assert re.fullmatch(r"This will take about \d+ (s|min)(,? .*)?\.\n", text), text
    return said(text)


def said(text: str) -> float:
    number, unit = re.findall(r"(\d+) (s|min)", text)[0]
    return float(number) * (60.0 if unit == "min" else 1.0)


@pytest.mark.parametrize("samples", [50, 20_000])
def test_samples_of_a_text_file_are_estimated_from_its_first_lines(samples: int, tmp_path: Path) -> None:
    (found,) = duration._samples_in([recording(tmp_path / "a.csv", samples)])
    assert found == pytest.approx(samples, rel=0.05)


def test_an_unreadable_file_counts_as_zero_samples(tmp_path: Path) -> None:
    (tmp_path / "empty.csv").touch()
    assert duration._samples_in([tmp_path / "none.csv", tmp_path / "empty.csv", tmp_path]) == [0, 0, 0]


def test_the_estimate_knows_how_many_samples_a_diagnosis_works_on() -> None:
    assert duration.MOST_SAMPLES == long_recordings.AT_MOST


def test_longer_recordings_give_longer_estimates(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
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


def test_the_estimate_of_a_fit_grows_with_the_number_of_epochs(capsys: pytest.CaptureFixture[str]) -> None:
    duration.announce_fit(["fit", "--config=demo", "--trainer.max_epochs=2"])
    few = seconds(capsys.readouterr().out)
    duration.announce_fit(["fit", "--config", "demo", "--trainer.max_epochs", "500"])
    assert few < seconds(capsys.readouterr().out)


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["fit", "--help"],
        ["fit", "--config", "demo", "--print_config"],
        ["fit", "--config", "none"],
        ["fit", "--config", "demo", "--data.recordings", "{"],
        ["fit", "--data.recordings", "5"],
    ],
)
def test_nothing_is_announced_if_nothing_is_trained_or_arguments_are_invalid(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    duration.announce_fit(arguments)
    assert capsys.readouterr().out == ""


def test_a_slow_machine_and_the_first_compilation_lengthen_the_estimate(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    duration.announce_diagnose(["none.csv"])
    usual = seconds(capsys.readouterr().out)
    monkeypatch.setattr(duration, "measured", lambda processes: Machine(0.5, 0.6, 0.6))
    duration.announce_diagnose(["none.csv"])
    assert seconds(capsys.readouterr().out) == pytest.approx(usual / 0.3, rel=0.5)
    monkeypatch.setattr(duration, "_compiled", lambda part: False)
    duration.announce_diagnose(["none.csv"])
    assert "mostly for a one-time compilation" in capsys.readouterr().out


def test_the_estimate_of_a_diagnosis_grows_with_how_much_it_finds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    duration.announce_diagnose([recording(tmp_path / "long.csv", 100_000)])
    found = re.findall(r"(\d+) (s|min)", capsys.readouterr().out)
    nothing, little, much = (float(number) * (60 if unit == "min" else 1) for number, unit in found)
    assert nothing < little < much


def test_equal_limits_are_announced_as_one_duration(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(duration, "search_s", lambda rounds, samples: 20.0)
    duration.announce_diagnose(["none.csv"])
    assert " to " not in capsys.readouterr().out


MEASURED = {
    "slow": (10_000, 4, (35, 60)),
    "fast": (10_000, 7, (58, 98)),
    "slow, judge": (21_000, 6, (62, 97)),
    "nothing missing, slow": (10_000, 1, (13, 24)),
    "nothing missing, slow, judge": (21_000, 1, (17, 33)),
    "nothing missing, all four": (41_000, 1, (23, 46)),
}
"""Recordings of the README with samples, rounds and processor seconds of their diagnosis on two machines; the
constants of the model lie between the two (`benchmarks/durations.py --rounds`)."""
KEPT_APART = {
    "a motor": (30_000, 3, (110,)),
    "a piezo stack": (9_417, 6, (75,)),
    "drawn, nothing found": (33_884, 1, (21,)),
}
"""The same for recordings to which the constants were not fitted: real ones, and one drawn by the proof."""


@pytest.mark.parametrize(("samples", "rounds", "measured_s"), [*MEASURED.values(), *KEPT_APART.values()])
def test_the_announced_duration_of_a_diagnosis_is_right_within_a_factor_of_two(
    samples: int,
    rounds: int,
    measured_s: tuple[float, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(duration, "measured", lambda processes: Machine(1.0, 1.0, 1.0))
    modelled_s = duration.DIAGNOSIS_S + duration.search_s(rounds, samples)
    if (samples, rounds, measured_s) in MEASURED.values():
        assert min(measured_s) < modelled_s < max(measured_s)
    duration.announce_diagnose([recording(tmp_path / "a.csv", samples)])
    nothing, little, much = (said(one) for one in re.findall(r"\d+ (?:s|min)", capsys.readouterr().out))
    low, high = (nothing, nothing) if rounds == 1 else (little, much)
    assert 0.5 * low < min(measured_s) <= max(measured_s) < 2 * high


def test_the_remaining_time_of_a_diagnosis_follows_its_rounds() -> None:
    quick, slow = duration.Countdown(), duration.Countdown()
    for countdown, times in ((quick, 1.0), (slow, 3.0)):
        assert countdown.left("nominal: the simulation as it is", times) == ""
        assert countdown.left("retuned, 100 plays: 59.612 nm", 10.0 * times) == ""
        assert countdown.left("round 1: 7 explanations fitted; best creep", 30.0 * times) == ""
    left, longer = (one.left("  with creep: 3.1 nm", s) for one, s in ((quick, 31.0), (slow, 93.0)))
    assert left.startswith("; about ") and left.endswith(" left")
    assert said(longer) == pytest.approx(3 * said(left), rel=0.4)
    # A round that finds nothing is the last one.
    quick.left("round 2: 7 explanations fitted; best hum", 50.0)
    assert said(quick.left("decide: every effect against its rivals", 50.0)) < said(left)


def test_a_slower_machine_needs_longer() -> None:
    quick, busy = Machine(1.0, 1.0, 2.0), Machine(0.5, 0.25, 0.5)
    assert quick.seconds(8.0, 4.0) == 10.0
    assert busy.seconds(8.0, 4.0) == 80.0


def test_the_speed_of_this_machine_is_measured() -> None:
    machine.measured.cache_clear()
    found = machine.measured(2)
    assert found.speed > 0 and 0 < found.alone <= 1.1 and found.alone <= found.together <= 2.2


@pytest.mark.parametrize(
    "command",
    [["check", "a.csv"], ["diagnose", "a.csv"], ["run", "a.pt"], ["train", "fit", "--config", "recorded"]],
)
def test_the_duration_is_printed_before_torch_is_imported(command: list[str], tmp_path: Path) -> None:
    recording(tmp_path / "a.csv", 100)
    (tmp_path / "a.pt").touch()
    program = (
        "import sys\n"
        "from torchpi.cli import duration, main\n"
        "def announced(*_):\n"
        "    print('torch' in sys.modules)\n"
        "    sys.exit()\n"
        "duration._announce = announced\n"
        "main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, *command], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.stdout == "False\n", done.stderr
