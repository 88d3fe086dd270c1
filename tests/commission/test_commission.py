"""`torchpi commission` from short recordings to a page, and `torchpi run` on the stage that it writes."""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.train.conftest import recording, write
from torchpi.cli import commands
from torchpi.commission.commission import FORMATS, commission
from torchpi.control.trained import load_compensator
from torchpi.export import load_torchscript, trained_recordings
from torchpi.recordings.identity import recordings_sha256
from torchpi.recordings.options import RecordingOptions
from torchpi.recordings.recording import read_recording
from torchpi.stage import Stage
from torchpi.stage.identified import Identified


def torchpi(monkeypatch: pytest.MonkeyPatch, *arguments: str | Path) -> int:
    monkeypatch.setattr(sys, "argv", ["torchpi", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        commands.main()
    return int(ended.value.code or 0)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = tmp_path_factory.mktemp("recordings")
    return [write(folder, recording(f"r{seed}", seed)) for seed in range(3)]


@pytest.fixture(scope="module")
def printed(files: list[str], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder that a commissioning wrote, and the text that it printed."""
    folder = tmp_path_factory.mktemp("commissioned") / "mine"
    lines: list[str] = []
    paths = [Path(path) for path in files]
    commission(paths, folder, RecordingOptions(), "torchpi commission", 500.0, log=lines.append)
    return folder, "\n".join(lines)


@pytest.fixture
def folder(printed: tuple[Path, str]) -> Path:
    return printed[0]


def numbers(folder: Path) -> dict:
    found: dict = json.loads((folder / "commission.json").read_text(encoding="utf-8"))
    return found


def test_at_most_ten_lines_state_the_estimated_duration_and_the_error(printed: tuple[Path, str]) -> None:
    folder, text = printed
    lines = text.splitlines()
    assert len(lines) <= 10
    assert re.search(r"about \d+ s$", lines[0]) and "held out" in lines[0]
    tracking = numbers(folder)["tracking"]
    assert any("→" in line and "rms on your stage, held out" in line for line in lines)
    assert tracking["with_rms_um"] < 0.2 * tracking["without_rms_um"]


def test_commissioning_writes_the_exports_the_stage_a_page_and_numbers(folder: Path) -> None:
    names = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert names == {
        "compensator.pt",
        "compensator.h",
        "compensator.c",
        "compensator_selftest.c",
        "compensator.json",
        "compensator.html",
        "stage.pt",
        "commission.html",
        "commission.json",
        "checkpoints/best.ckpt",
    }
    assert set(FORMATS) == {"torchscript", "c", "json", "page"}
    assert load_compensator(folder).preview == load_torchscript(folder / "compensator.pt").preview


def test_the_first_screen_of_the_page_states_the_error_and_its_origin(folder: Path) -> None:
    page = (folder / "commission.html").read_text(encoding="utf-8")
    first = page[page.index('<p class="answer"') : page.index("<section")]
    without, with_ = (1e3 * numbers(folder)["tracking"][f"{name}_rms_um"] for name in ("without", "with"))
    shown = [float(text) for text in re.search(r"<strong>([\d.]+) nm → ([\d.]+) nm<", first).groups()]
    np.testing.assert_allclose(shown, [without, with_], rtol=0.01)
    assert "Simulated" in first and "identified from the other recordings" in first
    own_nm = 1e3 * numbers(folder)["tracking"]["stage_heldout_rms_um"]
    assert f"{own_nm:.3g}" in first
    assert "default-src 'none'" in page and not re.search(r"(?:src|href)=\"?https?:|@import", page)
    assert "<figure" in first and "linked-data" in first


def test_compensator_checkpoint_json_and_stage_carry_the_hash_of_the_recordings(
    folder: Path, files: list[str]
) -> None:
    trained = recordings_sha256([read_recording(path) for path in files[:2]])
    stage = Stage.load(folder / "stage.pt")
    assert stage.identified is not None and stage.identified.recordings_sha256 == trained
    assert trained_recordings(folder / "compensator.pt") == trained
    assert load_compensator(folder).recordings_sha256 == trained
    assert json.loads((folder / "compensator.json").read_text())["recordings_sha256"] == trained
    assert numbers(folder)["recordings"] == {"train": files[:2], "heldout": files[2], "sha256": trained}


def motion(path: Path, high_um: float) -> Path:
    """A sine from 1 µm up, away from the limits of the voltage."""
    t = np.arange(400) / 1000.0
    y = 1.0 + 0.5 * high_um * (1 - np.cos(2 * np.pi * 5 * t))
    rows = np.column_stack([t, y])
    np.savetxt(path, rows, "%.9g", ",", header="time_s,yd_um", comments="")
    return path


def test_run_uses_the_stage_beside_the_compensator_and_says_so(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    compensator, wanted = folder / "compensator.pt", motion(tmp_path / "motion.csv", 3.0)
    output = ("--output", tmp_path / "loop")
    assert torchpi(monkeypatch, "run", compensator, "--trajectory", wanted, *output) == 0
    done = capsys.readouterr()
    assert f"Stage: {folder / 'stage.pt'}, identified from your recordings" in done.out
    assert "neither the voltage nor its rate reaches a limit" in done.out
    assert done.err == ""


def test_an_export_includes_its_stage(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert torchpi(monkeypatch, "export", folder, "--output", tmp_path / "x", "--to", "torchscript") == 0
    assert Stage.load(tmp_path / "x_stage.pt").to_dict() == Stage.load(folder / "stage.pt").to_dict()
    (tmp_path / "stage.pt").write_bytes(b"that of another compensator")
    wanted = motion(tmp_path / "motion.csv", 4.0)
    assert torchpi(monkeypatch, "run", tmp_path / "x.pt", "--trajectory", wanted) == 0
    assert f"Stage: {tmp_path / 'x_stage.pt'}" in capsys.readouterr().out


@pytest.mark.filterwarnings("default::torchpi.errors.RecordingWarning")
def test_run_warns_in_one_line_if_the_stage_is_from_other_recordings(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    own = Stage.load(folder / "stage.pt")
    assert isinstance(own.identified, Identified)
    other = replace(own.identified, recordings_sha256="a" * 64)
    Stage.from_dict({**own.to_dict(), "identified": other.plain()}).save(tmp_path / "other.pt")
    wanted = motion(tmp_path / "motion.csv", 4.0)
    arguments = ("--trajectory", wanted, "--stage", tmp_path / "other.pt", "--output", tmp_path / "loop")
    assert torchpi(monkeypatch, "run", folder / "compensator.pt", *arguments) == 0
    error = capsys.readouterr().err
    assert error.startswith("torchpi: warning: stage and compensator were made from different recordings")
    assert error.count("\n") == 1


def test_run_states_for_which_motion_and_when_the_rate_reaches_a_limit(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    slow, fast = motion(tmp_path / "slow.csv", 1.0), motion(tmp_path / "fast.csv", 4.0)
    arguments = ("--trajectory", f"[{slow}, {fast}]", "--max_slew_v_s", "80", "--output", tmp_path / "loop")
    assert torchpi(monkeypatch, "run", folder / "compensator.pt", *arguments) == 0
    text = capsys.readouterr().out
    assert "On slow.csv neither the voltage nor its rate reaches a limit" in text
    assert re.search(
        r"On fast\.csv the rate of the voltage reaches its limit of 80 V/s .* from 0\.\d+ s", text
    )
    loop = json.loads((tmp_path / "loop" / "loop.json").read_text())
    met = [one["drives"]["torchpi"]["limits_met"] for one in loop["trajectories"]]
    assert met[0] == [] and met[1][0]["quantity"] == "slew" and met[1][0]["value"] > 80


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda files, folder: files[:1], "found 1, expected two or more"),
        (lambda files, folder: [*files, files[0]], "expected different recordings"),
        (lambda files, folder: [*files, str(folder / "nowhere.csv")], "nowhere.csv"),
        (
            lambda files, folder: [*files, write(folder, recording("faster", 5, fs_hz=2000.0))],
            "expected one rate",
        ),
        (lambda files, folder: [*files, "--output", files[0]], "expected a folder"),
        (lambda files, folder: [*files, "--zero", "last"], "zero"),
    ],
)
def test_bad_input_gives_one_line_and_exit_code_2_and_leaves_existing_files(
    change,
    expected: str,
    files: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    output = tmp_path / "mine"
    output.mkdir()
    (output / "stage.pt").write_bytes(b"of before")
    arguments = change(files, tmp_path)
    arguments = arguments if "--output" in arguments else [*arguments, "--output", str(output)]
    assert torchpi(monkeypatch, "commission", *arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("torchpi: error: ") and error.count("\n") == 1 and expected in error
    assert [path.name for path in output.iterdir()] == ["stage.pt"]
    assert (output / "stage.pt").read_bytes() == b"of before"


def test_a_failure_at_the_last_file_leaves_the_previous_files_intact(
    files: list[str], folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from torchpi.errors import ArtifactError
    from torchpi.export.formats import write_together

    def fails(path: Path) -> None:
        raise ArtifactError(f"{path}: no space")

    (tmp_path / "stage.pt").write_bytes(b"of before")
    stage = Stage.load(folder / "stage.pt")
    with pytest.raises(ArtifactError, match="no space"):
        write_together({tmp_path / "stage.pt": stage.write, tmp_path / "commission.html": fails})
    assert [path.name for path in tmp_path.iterdir()] == ["stage.pt"]
    assert (tmp_path / "stage.pt").read_bytes() == b"of before"
