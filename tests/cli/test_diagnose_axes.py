"""`torchpi diagnose` of several axes."""

import json
from pathlib import Path

import pytest

from tests.identification.test_diagnosis_of_axes import linear
from tests.stage.two_axes import recordings, two_axes
from torchpi.cli.commands import diagnose_
from torchpi.cli.predict import predict_file
from torchpi.errors import ConfigError, RecordingError, SimulationError
from torchpi.recordings.multi_axis import write_multi_axis


def files(folder: Path, levels: tuple[float, ...] = (0.3, 0.6)) -> list[Path]:
    paths = []
    for one in recordings(two_axes(), levels, 3):
        paths.append(folder / f"{one.name.replace(' ', '_')}.csv")
        write_multi_axis(paths[-1], one)
    return paths


def test_diagnosing_a_linear_simulation_writes_a_page_numbers_and_a_stage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    linear().save(tmp_path / "linear.pt")
    paths, output = files(tmp_path), tmp_path / "found"
    diagnose_(paths, output, str(tmp_path / "linear.pt"), seconds=1.0)
    printed = capsys.readouterr().out
    assert "The simulation leaves out hysteresis in the actuators" in printed
    content = json.loads((output / "diagnosis.json").read_text())
    assert content["named"].startswith("hysteresis in the actuators")
    assert content["heldout"] == ["0.3_3", "0.6_3"]
    page = (output / "report.html").read_text()
    assert content["summary"] in page and "<svg" in page
    predict_file(output / "stage.pt", paths[0], tmp_path / "predicted.csv")


def test_unsuitable_simulations_recordings_and_options_are_refused(tmp_path: Path) -> None:
    paths = files(tmp_path, (0.3,))
    with pytest.raises(
        SimulationError, match=r"column: found no stage of several axes, expected the stage.pt"
    ):
        diagnose_(paths, tmp_path / "found", "column")
    with pytest.raises(RecordingError, match="found 2 realisations at one amplitude, expected at least 3"):
        diagnose_(paths[:2], tmp_path / "found")
    one = tmp_path / "one.csv"
    one.write_text("time_s,input_v,output_um\n" + "".join(f"{k / 100},{k % 7},{k % 5}\n" for k in range(50)))
    with pytest.raises(RecordingError, match=r"one.csv: no column 'input_1_v', expected numbered inputs"):
        diagnose_([*paths, one], tmp_path / "found")
    with pytest.raises(ConfigError, match="--seconds: found 3, expected none for a stage of one axis"):
        diagnose_([one], tmp_path / "found", seconds=3.0)
