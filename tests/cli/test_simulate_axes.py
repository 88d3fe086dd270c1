"""`torchpi simulate` of several axes."""

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.stage.two_axes import two_axes
from torchpi.cli.commands import simulate
from torchpi.errors import ArtifactError, ConfigError
from torchpi.recordings.multi_axis import read_multi_axis


def test_every_input_has_a_multisine_of_its_own(tmp_path: Path) -> None:
    two_axes().save(tmp_path / "stage.pt")
    simulate(
        "multisine", tmp_path / "stage.pt", tmp_path / "run.csv", 1.0, options={"high_v": 0.5, "low_v": -0.5}
    )
    found = read_multi_axis(tmp_path / "run.csv", periods=None)
    assert found.periods == 2
    assert abs(np.corrcoef(found.u.T)[0, 1]) < 0.5
    expected = two_axes().simulate(torch.from_numpy(found.u)[None])[0].numpy()
    np.testing.assert_array_equal(found.y, expected)


def test_proportional_inputs_and_files_that_are_not_a_stage_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "stage.pt"
    two_axes().save(path)
    with pytest.raises(
        ConfigError, match="--excitation: found paper_multisine, which moves all inputs in prop"
    ):
        simulate(stage=path, output=tmp_path / "run.csv")
    path.write_text("")
    with pytest.raises(ArtifactError, match=r"stage.pt: found no stage of several axes"):
        simulate("multisine", path, tmp_path / "run.csv")
