"""`python -m train fit` and `torchpi predict` with an oscillator."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from tests.cli.test_predict import torchpi, write
from tests.stage.oscillators import RATE_HZ, an_oscillator, multisine
from tests.stage.two_axes import two_axes
from torchpi.cli.predict import predict_file
from torchpi.errors import ConfigError, RecordingError, SimulationError
from torchpi.stage.bouc_wen_oscillator import BoucWenOscillator
from train import oscillator
from train.cli import main


@pytest.mark.parametrize("column", ["force_n", "input_v"])
def test_the_output_file_contains_the_input_and_the_predicted_displacement(
    column: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, u = an_oscillator(), multisine(500)
    one.save(tmp_path / "stage.pt")
    given = write(tmp_path / "in.csv", time_s=np.arange(500) / RATE_HZ, **{column: u})
    out = tmp_path / "out.csv"
    for options, periodic in (((), False), (("--periodic", "true"), True)):
        command = ("predict", tmp_path / "stage.pt", given, "--output", out, *options)
        assert torchpi(*command, monkeypatch=monkeypatch) == 0
        assert out.read_text().splitlines()[0] == f"time_s,{column},output_um"
        y = one.simulate(torch.from_numpy(u)[None], periodic)[0].numpy()
        np.testing.assert_array_equal(np.loadtxt(out, delimiter=",", skiprows=1)[:, 1:], np.stack([u, y], 1))


def test_a_file_is_predicted_at_its_own_sample_rate(tmp_path: Path) -> None:
    an_oscillator().save(tmp_path / "stage.pt")
    u = multisine(500, factor=2)
    given = write(tmp_path / "in.csv", time_s=np.arange(1000) / (2 * RATE_HZ), force_n=u)
    predicted = predict_file(tmp_path / "stage.pt", given, tmp_path / "out.csv")
    y = an_oscillator().at_sample_rate(2 * RATE_HZ).simulate(torch.from_numpy(u)[None])[0].numpy()
    np.testing.assert_allclose(predicted.y, y, rtol=1e-9)


def test_columns_and_options_that_do_not_fit_the_stage_are_refused(tmp_path: Path) -> None:
    an_oscillator().save(tmp_path / "stage.pt")
    two_axes().save(tmp_path / "two.pt")
    given = write(tmp_path / "in.csv", time_s=np.arange(9) / RATE_HZ, torque=np.ones(9))
    with pytest.raises(RecordingError, match="input_v"):
        predict_file(tmp_path / "stage.pt", given, tmp_path / "out.csv")
    with pytest.raises(SimulationError, match="expected no --simulation"):
        predict_file(tmp_path / "stage.pt", given, tmp_path / "out.csv", simulation="column")
    with pytest.raises(ConfigError, match="expected an oscillator with --periodic"):
        predict_file(tmp_path / "two.pt", given, tmp_path / "out.csv", periodic=True)
    assert not (tmp_path / "out.csv").exists()


def config(folder: Path, **settings: object) -> Path:
    u = np.tile(multisine(1024, 12.0), 3)
    y = an_oscillator().simulate(torch.from_numpy(u)[None])[0].numpy()
    y += np.random.default_rng(0).standard_normal(len(u))
    name = write(folder / "run.csv", time_s=np.arange(len(u)) / RATE_HZ, force_n=u, output_um=y)
    content = {
        "recordings": [str(name)],
        "periods": 3,
        "heldout": 0.25,
        "between": "band_limited",
        **settings,
    }
    path = folder / "one.yaml"
    path.write_text(yaml.safe_dump({"oscillator": content}))
    return path


def test_fitting_an_oscillator_writes_its_stage_and_metrics(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "run"
    assert main(["fit", "--config", str(config(tmp_path, exponent=1)), "--output", str(output)]) == 0
    assert "heldout  run" in capsys.readouterr().out
    assert BoucWenOscillator.load(output / "stage.pt").sample_rate_hz == RATE_HZ
    metrics = json.loads((output / "metrics.json").read_text())
    (heldout,) = metrics["heldout"]
    assert heldout["rms_um"] < 1.1 * heldout["noise_rms_um"] < 0.01 * heldout["motion_rms_um"]
    assert metrics["parameters"]["mass_kg"]["value"] == pytest.approx(0.8, rel=0.02)
    assert metrics["parameters"]["exponent"]["half_width_95"] is None


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"plays": 3}, "found the key plays, expected one of recordings, periods"),
        ({"skip_s": 1}, "found the key skip_s, expected one of recordings, periods"),
        ({"recordings": "run.csv"}, "recordings: found 'run.csv', expected a list of files"),
        ({"periods": 0}, "periods: found 0, expected a whole number, 1 or more"),
        ({"periods": 5}, "run: found 3072 samples, expected a multiple of 5 periods"),
        ({"heldout": 1}, "heldout: found 1, expected a number from 0 to below 1"),
    ],
)
def test_invalid_settings_are_refused_by_name(settings: dict, message: str, tmp_path: Path) -> None:
    path = config(tmp_path, **settings)
    with pytest.raises((ConfigError, RecordingError), match=message):
        oscillator.fit(["fit", "--config", str(path), "--output", str(tmp_path / "run")], path)
    assert not (tmp_path / "run").exists()
