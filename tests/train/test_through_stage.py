"""A compensator trained through an augmented stage tracks better on an independently written plant."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from torchpi.excitation.signals import random_trajectory
from torchpi.export import load_torchscript
from torchpi.stage import Stage
from train import results
from train.callbacks import TensorBoardFigures
from train.cli import main
from train.tracking import tracking_notes

FS_HZ, FINER = 2000.0, 10
R_V, W = [0.0, 0.2, 0.6, 1.3, 2.5], [0.45, 0.1, 0.1, 0.1, 0.1]
LAG_HZ, MODE_HZ, DAMPING = 60.0, 170.0, 0.1
SMALL = [
    "--config=configs/through_stage.yaml",
    "--model.plays=8",
    "--model.degree=2",
    "--model.creep_time_constants_s=[]",
    "--model.iterations=3",
    "--trainer.max_epochs=5",
    "--trainer.figures_every=0",
    "--data.follow.duration_s=0.5",
    "--data.follow.train=[{trajectory: random, seed: 1}, {trajectory: fast}]",
    "--data.follow.heldout=[{trajectory: random, seed: 11}]",
    "--data.simulate.train=[{excitation: sine_5hz, duration_s: 0.6}, "
    "{excitation: multisine, duration_s: 1.0, seed: 2, options: {high_hz: 60}}]",
]


def plant(u: np.ndarray) -> np.ndarray:
    """Return y at each tick, read before that tick's command is held: lag, plays and mode in small steps."""
    step_s = 1 / (FS_HZ * FINER)
    kept = math.exp(-2 * math.pi * LAG_HZ * step_s)
    omega = 2 * math.pi * MODE_HZ
    v, x, x_dot, y = 0.0, 0.0, 0.0, []
    h = [0.0] * len(R_V)
    for command in u.tolist():
        y.append(x)
        for _ in range(FINER):
            v = kept * v + (1 - kept) * command
            h = [max(v - r, min(v + r, state)) for r, state in zip(R_V, h, strict=True)]
            force = sum(w * state for w, state in zip(W, h, strict=True))
            x_dot += step_s * (omega**2 * (force - x) - 2 * DAMPING * omega * x_dot)
            x += step_s * x_dot
    return np.array(y)


def missed_um(run: Path) -> float:
    """Return the rms tracking error of the deployed compensator on the plant for a motion not trained on."""
    compensator = load_torchscript(run / "compensator.pt")
    _, yd = random_trajectory(0.8, FS_HZ, 1.0, 6.0, high_hz=40.0, seed=99)
    ahead = np.concatenate([yd, np.full(compensator.preview, yd[-1])])[compensator.preview :]
    y = plant(np.array([compensator.step(sample) for sample in ahead.tolist()]))
    return float(np.sqrt(np.mean((y - yd)[200:] ** 2)))


def without_pictures(patched: pytest.MonkeyPatch) -> None:
    """Skip the pictures, which take most of the time of a short run."""
    patched.setattr(results, "_write_report", lambda *_: None)
    patched.setattr(TensorBoardFigures, "draw", lambda *_: None)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One training through the stage with lag and mode, one through its hysteresis alone."""
    folder = tmp_path_factory.mktemp("through")
    effects = [
        {"name": "amplifier_lag", "values": {"cutoff_hz": LAG_HZ}},
        {"name": "resonance", "values": {"frequency_hz": MODE_HZ, "damping_ratio": DAMPING}},
    ]
    hysteresis = {"thresholds_v": R_V, "weights": [*W, 0.0]}
    limits = {"min_voltage_v": 0.0, "max_voltage_v": 10.0}
    stage = Stage(FS_HZ, hysteresis, effects, alignment=1, noise_um=0.001, **limits)
    for name, one in (("augmented", stage), ("plain", stage.plain())):
        one.save(folder / f"{name}-stage.pt")
        given = ["--model.stage", str(folder / f"{name}-stage.pt"), "--output", str(folder / name)]
        with pytest.MonkeyPatch.context() as patched:
            without_pictures(patched)
            assert main(["fit", *SMALL, *given]) == 0
    return {name: folder / name for name in ("augmented", "plain")}


def test_training_through_the_augmented_stage_improves_tracking_on_the_plant(runs: dict[str, Path]) -> None:
    assert missed_um(runs["augmented"]) < 0.2 * missed_um(runs["plain"])


def test_metrics_show_tracking_before_and_after(runs: dict[str, Path]) -> None:
    metrics = json.loads((runs["augmented"] / "metrics.json").read_text())
    tracking = metrics["tracking"]
    assert set(tracking) == {"plain", "before", "after"}
    assert set(tracking["after"]) == {"rms_um", "max_um", "rms_percent", "max_percent"}
    assert tracking["after"]["rms_um"] < tracking["before"]["rms_um"] < tracking["plain"]["rms_um"]
    assert set(metrics) >= {"train", "heldout", "baseline_lstsq", "loading_excluded"}
    assert "held-out motions" in metrics["how"]["epoch_chosen_by"]
    (said,) = tracking_notes(metrics)
    assert said.startswith("Tracking error of the held-out motions on") and "trained through" in said


def test_the_stage_predicts_the_behaviour_of_the_plant(runs: dict[str, Path]) -> None:
    stage = Stage.load(runs["augmented"].parent / "augmented-stage.pt")
    stream, u = stage.stream(compiled=False), 5 - 5 * np.cos(2 * np.pi * 8 * np.arange(600) / FS_HZ)
    y = np.array([stream.step(sample)[0] for sample in u.tolist()])
    assert np.abs(y - plant(u)).max() < 0.02 * np.ptp(y)


def test_training_through_a_stage_may_start_from_own_recordings(
    runs: dict[str, Path], recordings: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_pictures(monkeypatch)
    stage = runs["augmented"].parent / "augmented-stage.pt"
    given = ["--model.stage", str(stage), "--output", str(tmp_path / "run"), "--data.simulate=null"]
    assert main(["fit", *SMALL[:-1], "--data.recordings", json.dumps(recordings), *given]) == 0
    tracking = json.loads((tmp_path / "run" / "metrics.json").read_text())["tracking"]
    assert set(tracking) == {"before", "after"}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--model.stage=missing.pt"], "missing.pt: no such file"),
        (["--data.follow.low=0.9"], "data.follow.low: found 0.9"),
        (["--data.follow.train=[{trajectory: quick}]"], "quick"),
    ],
)
def test_invalid_arguments_give_a_one_line_error(
    arguments: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    assert main(["fit", "--config=configs/through_stage.yaml", "--output", str(run), *arguments]) == 2
    error = capsys.readouterr().err.strip()
    assert said in error and "\n" not in error and not run.exists()
