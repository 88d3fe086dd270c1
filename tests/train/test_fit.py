"""One small training from files to a run folder, an interruption, and its resumption."""

import hashlib
import json
import signal
from pathlib import Path
from typing import Any

import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.custom_scalar.layout_pb2 import Layout

from torchpi.control.trained import load_compensator
from torchpi.export import load_torchscript
from torchpi.operators.motion import backward_motion
from torchpi.recordings.identity import recordings_sha256
from torchpi.recordings.recording import read_recording
from torchpi.stage import Stage
from train import cli
from train.callbacks import EpochProgress
from train.cli import main

NUMBERS = {"rms_v", "max_v", "rms_um", "max_um", "rms_percent", "max_percent"}
SMALL = [
    "--model.plays=6",
    "--model.degree=2",
    "--model.preview=1",
    "--model.iterations=2",
    "--trainer.max_epochs=4",
    "--trainer.figures_every=0",
]


def arguments(recordings: list[str], output: Path, *more: str) -> list[str]:
    return ["fit", "--data.recordings", json.dumps(recordings), "--output", str(output), *SMALL, *more]


@pytest.fixture(scope="module")
def run(recordings: list[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "small"
    assert main(arguments(recordings, folder)) == 0
    return folder


def test_metrics_keep_their_contract(run: Path) -> None:
    metrics = json.loads((run / "metrics.json").read_text())
    for part in ("train", "heldout", "baseline_lstsq", "loading_excluded"):
        assert set(metrics[part]) == NUMBERS
        assert all(value > 0 for value in metrics[part].values())
        assert metrics[part]["rms_v"] <= metrics[part]["max_v"]


def test_training_beats_the_two_stage_baseline(run: Path) -> None:
    metrics = json.loads((run / "metrics.json").read_text())
    assert metrics["heldout"]["rms_um"] < metrics["baseline_lstsq"]["rms_um"]


def test_seed_data_hashes_and_versions_are_recorded(run: Path, recordings: list[str]) -> None:
    facts = json.loads((run / "run.json").read_text())
    assert facts["seed"] == 0
    assert facts["data_sha256"] == {
        path: hashlib.sha256(Path(path).read_bytes()).hexdigest() for path in recordings
    }
    assert {"python", "torch", "lightning", "torchpi"} <= set(facts["versions"])
    assert json.loads((run / "metrics.json").read_text())["how"]["heldout"] == [recordings[-1]]


def test_the_deployed_file_is_the_best_checkpoint(run: Path) -> None:
    compensator = load_compensator(run)
    yd = 2.5 * (1 - torch.cos(torch.linspace(0, 20, 400, dtype=torch.float64)))
    deployed = load_torchscript(run / "compensator.pt")
    assert deployed.preview == 1
    with torch.no_grad():
        expected = compensator(backward_motion(yd[None], compensator.sample_period_s))[0]
    assert torch.equal(deployed.block(yd), expected)
    assert load_torchscript(run / "baseline.pt").preview == 0
    assert json.loads((run / "compensator.json").read_text())["plays"]["r"][0] == 0


def test_checkpoints_load_with_weights_only(run: Path) -> None:
    for name in ("best", "last"):
        assert torch.load(run / "checkpoints" / f"{name}.ckpt", weights_only=True)["epoch"] >= 0


def test_tensorboard_has_scalars_figures_and_the_result(run: Path) -> None:
    assert not (run / "tensorboard").exists()  # TensorBoard names a run by the folder that has its events
    events = EventAccumulator(str(run))
    events.Reload()
    tags = events.Tags()
    errors = ("error_um", "error_v", "largest_error_um", "largest_error_v")
    wanted = {f"{key}/{part}" for key in errors for part in ("train", "heldout")}
    assert wanted | {"loss/train", "loss/heldout", "result/heldout_rms_um"} <= set(tags["scalars"])
    assert not {"epoch", "chosen_by"} & set(tags["scalars"])
    assert min(tags["scalars"] + tags["images"]) == "error_um/heldout"  # TensorBoard's first card
    assert {"loop", "trace", "residual spectrum", "weights against rate"} <= set(tags["images"])
    layout = Layout.FromString(events.Tensors("custom_scalars__config__")[0].tensor_proto.string_val[0])
    charted = [tag for chart in layout.category[0].chart for tag in chart.multiline.tag]
    assert {f"^{name}$" for name in wanted if not name.startswith("largest_error_um")} == set(charted)


def test_a_report_page_is_written(run: Path) -> None:
    assert "<svg" in (run / "report.html").read_text()


def test_training_with_the_resolved_config_gives_the_same_metrics(run: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    assert main(["fit", "--config", str(run / "config.yaml"), "--output", str(again)]) == 0
    assert (again / "metrics.json").read_text() == (run / "metrics.json").read_text()


def test_an_interrupted_training_resumes_to_the_same_result(
    run: Path,
    recordings: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = tmp_path / "interrupted"
    ended = EpochProgress.on_train_epoch_end

    def interrupts(self: EpochProgress, trainer: Any, module: Any) -> None:
        if trainer.current_epoch == 2:
            raise KeyboardInterrupt
        ended(self, trainer, module)

    before = signal.getsignal(signal.SIGINT)
    with monkeypatch.context() as patched:
        patched.setattr(EpochProgress, "on_train_epoch_end", interrupts)
        assert main(arguments(recordings, folder)) == 130
    signal.signal(signal.SIGINT, before)
    assert "--ckpt_path last" in capsys.readouterr().out
    assert torch.load(folder / "checkpoints" / "last.ckpt", weights_only=True)["epoch"] == 1
    assert not (folder / "metrics.json").exists()

    assert main(arguments(recordings, folder, "--ckpt_path", "last")) == 0
    assert (folder / "metrics.json").read_text() == (run / "metrics.json").read_text()


def test_resuming_a_run_with_other_settings_is_refused(
    run: Path, recordings: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    written = (run / "run.json").read_text()
    assert main(arguments(recordings, run, "--ckpt_path", "last", "--model.degree=3")) == 2
    assert "degree" in capsys.readouterr().err
    assert (run / "run.json").read_text() == written


def test_adam_trains_on_windows(recordings: list[str], tmp_path: Path) -> None:
    folder = tmp_path / "adam"
    more = ("--model.optimizer=adam", "--data.window_samples=300", "--trainer.max_epochs=2")
    assert main(arguments(recordings, folder, *more)) == 0
    assert (folder / "metrics.json").exists()


def test_a_second_run_gets_a_numbered_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.new_run(None, "demo", None).path == Path("runs/demo")
    (tmp_path / "runs" / "demo").mkdir(parents=True)
    assert cli.new_run(None, "demo", None).path == Path("runs/demo-2")


def test_a_run_on_recordings_saves_a_stage_identified_from_the_training_set(
    run: Path, recordings: list[str]
) -> None:
    trained = recordings_sha256([read_recording(path) for path in recordings[:-1]])
    stage, found = Stage.load(run / "stage.pt"), json.loads((run / "metrics.json").read_text())["stage"]
    assert stage.identified is not None
    assert stage.identified.recordings_sha256 == load_compensator(run).recordings_sha256 == trained
    assert found["heldout"] == recordings[-1]
    assert found["heldout_rms_um"] == stage.identified.heldout_rms_um < 0.02
    assert f"{1e3 * found['heldout_rms_um']:.3g} nm" in (run / "report.html").read_text()
