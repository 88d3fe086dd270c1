"""Unusable arguments are refused in one line, with exit code 2, and leave nothing behind."""

import json
from pathlib import Path

import pytest

from tests.train.conftest import recording, write
from train.cli import main


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Return the one-line error message."""
    assert main(["fit", *arguments]) == 2
    said = capsys.readouterr().err.strip()
    assert said.startswith("torchpi: error: ") and "\n" not in said
    return said


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--model.degre=3"], "nearest is 'model.degree'"),
        (["--data.recordigs=a.csv"], "nearest is 'data.recordings'"),
        (["--model.degree=x"], "model.degree: found x, expected int"),
        (["--model.rate=quadratic"], "'linear'"),
        (["--data.evaluate_s=5"], "tuple[float, float]"),
        (["--data.recordings=a.csv", "--trainer.max_epochs=0"], "trainer.max_epochs"),
        (["--data.recordings=missing.csv"], "missing.csv"),
        ([], "data.recordings: found none"),
        (["--config=missing.yaml"], "missing.yaml"),
        (["--data.recordings=a.csv", "--ckpt_path=missing.ckpt"], "missing.ckpt"),
        (["--data.recordings=a.csv", "--ckpt_path=last"], "--output"),
        (["--data.recordings=a.csv", "--model.preview=soon"], "model.preview: found soon"),
    ],
)
def test_command_line_mistakes_are_refused(
    arguments: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert said in refused(arguments, capsys)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("data: {recordigs: [a.csv]}", "nearest is 'data.recordings'"),
        ("modle: {degree: 3}", "nearest is 'model"),
        ("data: {simulate: {train: [{excitaton: sine_5hz}]}}", "nearest is 'excitation'"),
        ("data: [", "parsing"),
        ("data: 3", "settings: "),
        ("model: null", ""),
        ("model: [1]", ""),
        ("seed_everything: -5", "-5 is not in bounds"),
        ("data: {simulate: {stage: configs/stage/default.yaml, train: []}}", "settings: "),
        ("data: !!python/object/apply:os.system ['true']", "python/object"),
        ("data: &a [*a]", ""),
        ("data: \x00", ""),
        ("data: " + 5000 * "[", ""),
    ],
)
def test_config_mistakes_are_refused(
    text: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "mine.yaml"
    config.write_text(text)
    assert said in refused(["--config", str(config)], capsys)


def test_incompatible_settings_are_refused(
    recordings: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    common = ["--data.recordings", json.dumps(recordings), "--output", str(tmp_path / "run")]
    assert "adam" in refused([*common, "--data.window_samples=100"], capsys)
    assert "inside" in refused([*common, "--data.evaluate_s=[3, 4]"], capsys)
    assert "max_stepps" in refused([*common, "--trainer.lightning={max_stepps: 3}"], capsys)
    callbacks = refused([*common, "--trainer.lightning={callbacks: [x]}"], capsys)
    assert "trainer.lightning.callbacks" in callbacks
    assert "'gpu', expected 'cpu'" in refused([*common, "--trainer.lightning={accelerator: gpu}"], capsys)
    assert not (tmp_path / "run").exists()


def test_different_sample_rates_are_refused(
    recordings: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    slower = write(tmp_path, recording("slower", 5, fs_hz=500.0))
    said = refused(["--data.recordings", json.dumps([recordings[0], slower])], capsys)
    assert "500 Hz" in said and "1000 Hz" in said and "slower.csv" in said


def test_holding_out_a_training_file_is_refused(
    recordings: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    said = refused(["--data.recordings", json.dumps(recordings), "--data.heldout", recordings[0]], capsys)
    assert recordings[0] in said


def test_an_output_in_use_is_refused(
    recordings: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    common = ["--data.recordings", json.dumps(recordings), "--output"]
    (tmp_path / "notes.txt").write_text("mine")
    assert "notes.txt" in refused([*common, str(tmp_path)], capsys)
    assert "file" in refused([*common, str(tmp_path / "notes.txt")], capsys)
    assert "file" in refused([*common, str(tmp_path / "notes.txt" / "run")], capsys)
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_a_file_that_is_not_a_checkpoint_is_refused(
    recordings: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.ckpt"
    other.write_text("not a checkpoint")
    output = tmp_path / "run"
    common = ["--data.recordings", json.dumps(recordings), "--output", str(output), "--model.plays=3"]
    assert "other.ckpt" in refused([*common, "--ckpt_path", str(other)], capsys)
    assert not output.exists()
