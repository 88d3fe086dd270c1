"""From the command line: a simulation in the user's own file or in a column, and the identified stage."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.diagnosis.plants import FS_HZ, NOISE_UM, multisine
from tests.simulators import own_model
from torchpi.cli import commands
from torchpi.cli.diagnose import load_simulation
from torchpi.errors import SimulationError
from torchpi.recordings.recording import Recording, read_recording, write_recording
from torchpi.stage import Stage


def torchpi(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["torchpi", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        commands.main()
    return int(ended.value.code or 0)


def recording(samples: int = 1000) -> Recording:
    """Return the simulation plus noise as the output, with the simulation itself as a column."""
    u = multisine(samples)
    y = own_model.simulate(u, FS_HZ)
    noise = NOISE_UM * np.random.default_rng(1).standard_normal(samples)
    return Recording("a", np.arange(samples) / FS_HZ, u, y + noise, FS_HZ, simulated=y)


@pytest.mark.parametrize("simulation", [f"{own_model.__file__}:simulate", "column"])
def test_a_correct_simulation_is_diagnosed_and_predicts(
    simulation: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "path", [*sys.path])
    one, out = recording(), tmp_path / "out"
    write_recording(tmp_path / "a.csv", one)
    given = ("--simulation", simulation)
    command = ("diagnose", tmp_path / "a.csv", *given, "--output", out, "--executor", "here")
    assert torchpi(monkeypatch, *command) == 0
    assert "Not tried:" in (out / "report.html").read_text(encoding="utf-8")
    predicted = tmp_path / "predicted.csv"
    command = ("predict", out / "stage.pt", tmp_path / "a.csv", *given, "--output", predicted)
    assert torchpi(monkeypatch, *command) == 0
    assert one.simulated is not None
    np.testing.assert_allclose(read_recording(predicted).y, one.simulated, atol=NOISE_UM)


def test_a_stage_of_the_package_can_be_given_as_simulation_by_name() -> None:
    found = load_simulation("default")
    assert isinstance(found, Stage) and found.to_dict() == Stage.load("default").to_dict()
    with pytest.raises(SimulationError, match="found 'defualt', expected a stage"):
        load_simulation("defualt")


def test_a_simulated_column_missing_from_one_file_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_recording(tmp_path / "a.csv", recording(400))
    write_recording(tmp_path / "b.csv", replace(recording(400), simulated=None))
    files = tmp_path / "a.csv", tmp_path / "b.csv"
    command = ("diagnose", *files, "--simulation", "column", "--output", tmp_path / "out")
    assert torchpi(monkeypatch, *command) == 2
    error = capsys.readouterr().err.strip()
    assert "b.csv: found 0 columns 'simulated…'" in error and "expected one, simulated_um" in error
    assert "\n" not in error and not (tmp_path / "out").exists()


def test_the_simulated_column_is_read_in_its_unit_and_not_taken_for_the_output(tmp_path: Path) -> None:
    one = recording(400)
    columns = {"time_s": one.t, "u [V]": one.u, "pos [nm]": 1e3 * one.y}
    columns["simulated [nm]"] = 1e3 * own_model.simulate(one.u, FS_HZ)
    table = np.column_stack(list(columns.values()))
    np.savetxt(tmp_path / "a.csv", table, "%.17g", ",", header=",".join(columns), comments="")
    found = read_recording(tmp_path / "a.csv", simulated=True)
    np.testing.assert_allclose(found.y, one.y, atol=1e-12)
    np.testing.assert_allclose(found.simulated, one.simulated, atol=1e-12)
    assert read_recording(tmp_path / "a.csv").simulated is None
    assert found.slice(0.05, 0.1).simulated is not None and len(found.resampled(500.0).simulated) == 100
