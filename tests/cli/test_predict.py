"""`torchpi predict` computes the displacement of a stage from a file of voltages."""

import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.simulators import own_model
from torchpi.cli import commands, predict
from torchpi.operators.conformance import wandering
from torchpi.recordings.recording import read_recording
from torchpi.stage import Stage

RATE_HZ = 5000.0
COUPLING = {"name": "cross_coupling", "values": {"coupling_um_per_v": 0.1}, "aux": "aux_x"}
RESONANCE = {"name": "resonance", "values": {"frequency_hz": 300.0, "damping_ratio": 0.05}}


def stage(path: Path, *effects: dict) -> Stage:
    hysteresis = {"thresholds_v": [0.0, 0.3], "weights": [0.7, 0.2, 0.1]}
    one = Stage(1e4, hysteresis, effects, alignment=1, noise_um=0.01)
    one.save(path)
    return one


def write(path: Path, **columns: np.ndarray) -> Path:
    np.savetxt(
        path, np.column_stack(list(columns.values())), "%.17g", ",", header=",".join(columns), comments=""
    )
    return path


def torchpi(*arguments: str | Path, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(sys, "argv", ["torchpi", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        commands.main()
    return int(ended.value.code or 0)


def test_the_output_file_contains_the_displacement(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = stage(tmp_path / "stage.pt", COUPLING, RESONANCE)
    u, x = wandering(2, 700).numpy()
    t = np.arange(len(u)) / RATE_HZ
    given = write(tmp_path / "in.csv", time_s=t, input_v=u, aux_x=x, aux_other=2 * x)
    out = tmp_path / "out.csv"
    monkeypatch.setattr(predict, "AT_A_TIME", 256)
    assert torchpi("predict", tmp_path / "stage.pt", given, "--output", out, monkeypatch=monkeypatch) == 0
    assert out.read_text().splitlines()[0] == "time_s,input_v,output_um,aux_x,aux_other"
    back = read_recording(out)
    with torch.no_grad():
        rows = torch.from_numpy(np.stack([u, x]))[:, None]
        y, _ = one.at_sample_rate(RATE_HZ)(rows[0], None, {"aux_x": rows[1]})
    np.testing.assert_array_equal(back.y, y[0].numpy())
    np.testing.assert_array_equal(
        [back.t, back.u, back.aux["aux_x"], back.aux["aux_other"]], [t, u, x, 2 * x]
    )


def test_other_units_and_names_give_the_same_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stage(tmp_path / "stage.pt", RESONANCE)
    (u,) = wandering(1, 300).numpy()
    t = np.arange(len(u)) / RATE_HZ
    plain = write(tmp_path / "plain.csv", time_s=t, input_v=u)
    rig = write(tmp_path / "rig.csv", **{"time_ms": 1e3 * t, "u [mV]": 1e3 * u})
    bare = write(tmp_path / "bare.csv", **{"a": 0 * u, "b": 1e3 * u})
    options = ["--input_column", "b", "--input_unit", "mV", "--fs_hz", "5000"]
    for name, arguments in ((plain, []), (rig, []), (bare, options)):
        out = tmp_path / f"{name.stem}_out.csv"
        command = ("predict", tmp_path / "stage.pt", name, "--output", out, *arguments)
        assert torchpi(*command, monkeypatch=monkeypatch) == 0
    expected = read_recording(tmp_path / "plain_out.csv").y
    for name in ("rig", "bare"):
        np.testing.assert_allclose(read_recording(tmp_path / f"{name}_out.csv").y, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        (("time_s", "volume"), "no column 'input_v'"),
        (("time_s", "input_v"), "no column 'aux_x'"),
        (("input_v", "aux_x"), "time_s"),
    ],
)
def test_a_missing_column_is_named_in_one_line(
    columns: tuple[str, ...],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    stage(tmp_path / "stage.pt", COUPLING)
    given = write(tmp_path / "in.csv", **{name: np.arange(20) / 100 for name in columns})
    out = tmp_path / "out.csv"
    assert torchpi("predict", tmp_path / "stage.pt", given, "--output", out, monkeypatch=monkeypatch) == 2
    error = capsys.readouterr().err.strip()
    assert said in error and "\n" not in error and not out.exists()


def test_a_file_that_is_not_a_stage_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given = write(tmp_path / "in.csv", time_s=np.arange(20) / 100, input_v=np.zeros(20))
    assert torchpi("predict", given, given, monkeypatch=monkeypatch) == 2
    assert "not a stage file" in capsys.readouterr().err


def test_zero_voltage_gives_the_offset_of_the_stage(tmp_path: Path) -> None:
    one = stage(tmp_path / "stage.pt")
    np.testing.assert_array_equal(predict.predict(one, np.zeros(5), {}), 0.1)


CORRECTING = {
    "thresholds_v": [0.0],
    "weights": [0.0, 0.1],
    "simulation": {"reference": "mine:f", "gain": 2.0},
}
OWN = "tests.simulators.own_model:simulate"


def test_a_stage_that_corrects_a_simulation_calls_only_the_explicitly_named_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Stage(RATE_HZ, CORRECTING).save(tmp_path / "stage.pt")
    (u,) = wandering(1, 700).numpy()
    given = write(tmp_path / "in.csv", time_s=np.arange(len(u)) / RATE_HZ, input_v=u)
    monkeypatch.setattr(predict, "AT_A_TIME", 256)
    command = ("predict", tmp_path / "stage.pt", given, "--output", tmp_path / "out.csv")
    assert torchpi(*command, monkeypatch=monkeypatch) == 2
    error = capsys.readouterr().err.strip()
    assert (
        "corrects the simulation 'mine:f'" in error and "--simulation mine:f" in error and "\n" not in error
    )
    assert torchpi(*command, "--simulation", OWN, monkeypatch=monkeypatch) == 0
    np.testing.assert_allclose(
        read_recording(tmp_path / "out.csv").y, 2 * own_model.simulate(u, RATE_HZ) + 0.1, atol=1e-12
    )


def test_a_stage_that_corrects_a_recorded_simulation_reads_its_column(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Stage(RATE_HZ, {**CORRECTING, "simulation": {"reference": "column", "gain": 2.0}}).save(tmp_path / "s.pt")
    u, x = wandering(2, 700).numpy()
    given = write(tmp_path / "in.csv", time_s=np.arange(len(u)) / RATE_HZ, input_v=u, simulated_nm=1e3 * x)
    command = ("predict", tmp_path / "s.pt", given, "--output", tmp_path / "out.csv")
    assert torchpi(*command, monkeypatch=monkeypatch) == 0
    np.testing.assert_allclose(read_recording(tmp_path / "out.csv").y, 2 * x + 0.1, atol=1e-12)
    given = write(tmp_path / "none.csv", time_s=np.arange(len(u)) / RATE_HZ, input_v=u)
    assert torchpi("predict", tmp_path / "s.pt", given, monkeypatch=monkeypatch) == 2
    assert "found 0 columns 'simulated…'" in capsys.readouterr().err


def test_a_simulation_is_refused_for_a_stage_that_calls_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stage(tmp_path / "stage.pt")
    given = write(tmp_path / "in.csv", time_s=np.arange(20) / 100, input_v=np.zeros(20))
    assert torchpi("predict", tmp_path / "stage.pt", given, "--simulation", OWN, monkeypatch=monkeypatch) == 2
    assert "found a stage that calls no simulation" in capsys.readouterr().err
