"""`torchpi export` of a run of several axes."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.export.test_multi_axis import linear
from tests.stage.two_axes import recordings, two_axes
from torchpi.cli.commands import export
from torchpi.errors import ArtifactError, ConfigError
from torchpi.stage.multi_axis import MultiAxisStage
from train.multi_axis import judged

MADE = ("two.pt", "two_forward.pt", "two_stage.pt")


def left(folder: Path, stage: MultiAxisStage) -> Path:
    """Write a run folder with the stage and its metrics."""
    run = folder / "run"
    run.mkdir()
    stage.save(run / "stage.pt")
    every = judged(two_axes(), recordings(two_axes(), (0.3,), 2))
    (run / "metrics.json").write_text(json.dumps({"train": every, "heldout": []}))
    return run


def test_export_writes_the_inverse_the_forward_model_and_the_stage(tmp_path: Path) -> None:
    run = left(tmp_path, two_axes())
    export(run, tmp_path / "two", to="torchscript", band_hz=30.0)
    assert sorted(path.name for path in tmp_path.glob("two*")) == sorted(MADE)
    inverse = torch.jit.load(tmp_path / "two.pt")
    # Voltages and displacements are bounded by those that were recorded.
    every = json.loads((run / "metrics.json").read_text())["train"]
    ranges = np.array([one["input_range_v"] for one in every])
    np.testing.assert_array_equal(inverse.limits_v[:, 1], ranges[:, :, 1].max(0))
    inverse.block(torch.tensor([[0.0, 0.0], [1e3, 0.0]], dtype=torch.float64))
    assert inverse.held_inputs == 1
    assert MultiAxisStage.load(tmp_path / "two_stage.pt").inputs == 2


def test_a_stage_without_an_inverse_is_exported_as_forward_model_only(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    export(left(tmp_path, linear()), tmp_path / "two", to="json")
    assert sorted(path.name for path in tmp_path.glob("two*")) == ["two_forward.json", "two_stage.pt"]
    assert "no inverse: found 2 inputs and 1 outputs" in capsys.readouterr().out


def test_a_slew_limit_and_missing_metrics_are_refused(tmp_path: Path) -> None:
    run = left(tmp_path, two_axes())
    with pytest.raises(ConfigError, match=r"--max_slew_v_s: found 3.0, expected none for several axes"):
        export(run, tmp_path / "two", max_slew_v_s=3.0)
    (run / "metrics.json").write_text("{}")
    with pytest.raises(ArtifactError, match=r"metrics.json: not readable, expected the metrics of the run"):
        export(run, tmp_path / "two")
    assert not list(tmp_path.glob("two*"))
