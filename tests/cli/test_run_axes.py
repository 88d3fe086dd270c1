"""`torchpi run` of several axes."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.cli.test_export_axes import left
from tests.stage.two_axes import RATE_HZ, recordings, two_axes
from torchpi.cli.commands import export, run
from torchpi.cli.run_axes import trajectory_of
from torchpi.errors import ArtifactError, ConfigError, RecordingError, StageError
from torchpi.export.multi_axis.numbers import read_inverse
from torchpi.recordings.multi_axis import write_multi_axis


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exports")
    export(left(folder, two_axes()), folder / "two", to="torchscript,json")
    return folder / "two"


def test_errors_and_coupling_are_reported_beside_those_of_the_linear_inverse(
    exported: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(exported.with_suffix(".pt"))
    found = json.loads((exported / "loop.json").read_text())["random"]
    assert max(found["error_percent"]) < 1.0 < max(found["linear_error_percent"])
    assert np.max(found["coupling_percent"]) < 0.2 * np.max(found["linear_coupling_percent"])
    assert found["limited_outputs"] == 0
    assert "moves others" in capsys.readouterr().out


def test_json_and_torchscript_exports_give_the_same_voltages(exported: Path) -> None:
    inverse = read_inverse(exported.with_suffix(".json"), two_axes())
    yd = trajectory_of("random", inverse)[:300]
    loaded = torch.jit.load(exported.with_suffix(".pt"))
    np.testing.assert_array_equal(loaded.block(torch.from_numpy(yd)), inverse.block(yd))


def test_a_trajectory_from_a_file_is_followed(exported: Path, tmp_path: Path) -> None:
    t = np.arange(800) / RATE_HZ
    yd = np.stack([0.3 * np.sin(2 * np.pi * 5 * t), 0.2 * np.sin(2 * np.pi * 7 * t)], 1)
    path = tmp_path / "path.csv"
    np.savetxt(path, np.column_stack([t, yd]), delimiter=",", header="time_s,yd_1_um,yd_2_um", comments="")
    run(exported.with_suffix(".json"), trajectory=str(path), output=tmp_path / "loop")
    assert max(json.loads((tmp_path / "loop" / "loop.json").read_text())[str(path)]["error_percent"]) < 2.0


def test_mismatched_options_trajectories_and_stages_are_refused(exported: Path, tmp_path: Path) -> None:
    compensator = exported.with_suffix(".pt")
    with pytest.raises(ConfigError, match="--seed: found 1, expected none for several axes"):
        run(compensator, seed=1)
    with pytest.raises(ConfigError, match="--trajectory: found slow, expected a file with columns yd_1_um"):
        run(compensator, trajectory="slow")
    write_multi_axis(tmp_path / "one.csv", recordings(two_axes(), (0.3,), 1)[0])
    with pytest.raises(RecordingError, match="no column 'yd_1_um'"):
        run(compensator, trajectory=str(tmp_path / "one.csv"))
    with pytest.raises(ArtifactError, match=r"one.csv: found no stage of several axes"):
        run(compensator, tmp_path / "one.csv")
    changed = two_axes()
    changed.arrays()["poles"][0] *= 0.99
    with pytest.raises(ArtifactError, match="found the numbers of another stage"):
        read_inverse(exported.with_suffix(".json"), changed)
    (tmp_path / "short.csv").write_text(
        "time_s,yd_1_um,yd_2_um\n" + "".join(f"{k / RATE_HZ},0.1,{k}\n" for k in range(9))
    )
    with pytest.raises(
        StageError, match=r"trajectory: found an array of shape \(9, 2\), expected at least 600"
    ):
        run(compensator, trajectory=str(tmp_path / "short.csv"))
