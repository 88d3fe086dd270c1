"""A run that selects its form is no worse than its baselines and reports parameters at their bounds."""

import json
from pathlib import Path
from typing import Any

import pytest
import torch

from tests.train.conftest import recording, write
from torchpi.control.trained import load_compensator
from torchpi.errors import ConfigError
from train.cli import main
from train.data import RecordingsData
from train.module import InverseTraining
from train.results import at_their_bound, notes
from train.sensor_zero import fit_zero, on_bound


@pytest.fixture(scope="module")
def run(recordings: list[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "selected"
    assert (
        main(
            [
                "fit",
                "--config",
                "configs/recorded.yaml",
                "--output",
                str(folder),
                "--data.recordings",
                json.dumps(recordings),
                "--model.plays=8",
                "--trainer.figures_every=0",
            ]
        )
        == 0
    )
    return folder


def test_the_recipe_is_no_worse_than_either_baseline(run: Path) -> None:
    metrics = json.loads((run / "metrics.json").read_text())
    baselines = [metrics[name]["rms_v"] for name in ("baseline_lstsq", "baseline_plays")]
    assert metrics["heldout"]["rms_v"] <= min(baselines)
    assert metrics["how"]["monotone"]


def test_the_notes_name_the_selected_form_and_the_page_a_baseline(run: Path) -> None:
    how = json.loads((run / "metrics.json").read_text())["how"]
    assert len(how["selected"]) >= 2  # the initial form and the one that beat it
    assert any(how["selected"][-1]["form"] in note for note in notes(how))
    assert "least squares on plays" in (run / "report.html").read_text()


def test_the_voltage_limits_are_those_of_the_recordings(run: Path, recordings: list[str]) -> None:
    compensator = load_compensator(run)
    data = RecordingsData(recordings=recordings).load()
    voltages = torch.cat([torch.from_numpy(record.u) for record in (*data.train, *data.heldout)])
    limits = compensator.min_voltage_v, compensator.max_voltage_v
    assert limits == pytest.approx((float(voltages.min()), float(voltages.max())))


@pytest.mark.parametrize(
    "settings",
    [{"output_degree": 2}, {"train_thresholds": True}, {"rate": "neural"}, {"optimizer": "adam"}],
    ids=str,
)
def test_settings_that_exclude_a_selection_are_refused(settings: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=f"model.{next(iter(settings))}: found .*, expected"):
        InverseTraining(select=True, **settings)


def test_a_sensor_zero_at_its_bound_is_reported(tmp_path: Path) -> None:
    files = [write(tmp_path, recording(f"r{seed}", seed)) for seed in range(2)]
    data = RecordingsData(recordings=files, zero_s=(0.1, 0.4), evaluate_s=(0.5, 0.9))
    model = InverseTraining(plays=5, degree=2)
    model.build(data)
    [pair] = model.split.zero
    assert not on_bound(fit_zero(model.compensator, pair), pair)
    assert at_their_bound(model) == []
    far = pair._replace(motion=pair.motion._replace(yd=pair.motion.yd + 3.0))
    assert on_bound(fit_zero(model.compensator, far), far)
    model.split.zero[0] = far
    [text] = at_their_bound(model)
    assert "the zero of r1" in text and "the bound of its search" in text
