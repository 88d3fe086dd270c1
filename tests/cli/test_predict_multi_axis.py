"""`python -m train fit` and `torchpi predict` with a stage of several axes."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from tests.stage.two_axes import RATE_HZ, multisine, recordings, two_axes
from torchpi.cli.predict import predict_file
from torchpi.errors import ConfigError, RecordingError
from torchpi.recordings.multi_axis import MultiAxisRecording, read_multi_axis, write_multi_axis
from torchpi.stage.multi_axis import MultiAxisStage
from train import multi_axis


def given(path: Path, inputs: int = 2, fs_hz: float = RATE_HZ) -> np.ndarray:
    u = np.resize(multisine(np.random.default_rng(1), 400, 0.4), (400, inputs))
    write_multi_axis(path, MultiAxisRecording("in", u, np.zeros((400, 0)), fs_hz))
    return u


def test_the_output_file_contains_the_predicted_displacements(tmp_path: Path) -> None:
    stage, path = two_axes(), tmp_path / "stage.pt"
    stage.save(path)
    u = given(tmp_path / "in.csv")
    predict_file(path, tmp_path / "in.csv", tmp_path / "out.csv")
    header = (tmp_path / "out.csv").read_text().splitlines()[0]
    assert header == "time_s,input_1_v,input_2_v,output_1_um,output_2_um"
    y = stage.simulate(torch.from_numpy(u)[None])[0].numpy()
    np.testing.assert_array_equal(read_multi_axis(tmp_path / "out.csv").y, y)


@pytest.mark.parametrize(
    ("inputs", "fs_hz", "message"),
    [(3, RATE_HZ, "found 3 inputs, expected 2 as in"), (2, 500.0, "found 500 Hz, expected 1000 Hz as in")],
)
def test_a_file_with_other_inputs_or_sample_rate_than_the_stage_is_refused(
    inputs: int, fs_hz: float, message: str, tmp_path: Path
) -> None:
    two_axes().save(tmp_path / "stage.pt")
    given(tmp_path / "in.csv", inputs, fs_hz)
    with pytest.raises(RecordingError, match=message):
        predict_file(tmp_path / "stage.pt", tmp_path / "in.csv", tmp_path / "out.csv")


def config(folder: Path, **settings: object) -> Path:
    names = []
    for number, one in enumerate(recordings(two_axes(), (0.5,), 3)):
        names.append(str(folder / f"run{number}.csv"))
        write_multi_axis(names[-1], replace(one, name=f"run{number}"))
    content = {"recordings": names, "periods": 2, "modes": 2, "extra_elements": 0, "seconds": 1.0, **settings}
    path = folder / "two.yaml"
    path.write_text(yaml.safe_dump({"multi_axis": content}))
    return path


def test_fitting_several_axes_writes_a_stage_and_its_metrics(tmp_path: Path) -> None:
    path, output = config(tmp_path, heldout=["run2"]), tmp_path / "run"
    command = [sys.executable, "-m", "train", "fit", "--config", str(path), "--output", str(output)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert MultiAxisStage.load(output / "stage.pt").inputs == 2
    heldout = json.loads((output / "metrics.json").read_text())["heldout"]
    assert [one["name"] for one in heldout] == ["run2"]
    assert heldout[0]["rms_um"] < 0.1 * heldout[0]["motion_rms_um"]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"plays": 3}, "found the key plays, expected one of"),
        ({"heldout": ["run9"]}, "heldout: found"),
        ({"recordings": 3}, "recordings: found 3, expected an archive or a list of files"),
    ],
)
def test_invalid_settings_are_refused_by_name(settings: dict, message: str, tmp_path: Path) -> None:
    path = config(tmp_path, **settings)
    with pytest.raises(ConfigError, match=message):
        multi_axis.fit(["fit", "--config", str(path), "--output", str(tmp_path / "run")], path)
    assert not (tmp_path / "run").exists()
