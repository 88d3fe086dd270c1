"""Settings that are broken, absurd or malicious: each is used or refused in one line; none takes long."""

import json
from pathlib import Path

import pytest
from lightning import Trainer

from tests.hostile.limits import limited
from tests.train.conftest import recording, write
from train.cli import main

LAUGHS = "".join(
    f"{name}: &{name} [{', '.join([value] * 9)}]\n"
    for name, value in zip("abcdefghi", ["lol", *(f"*{one}" for one in "abcdefgh")], strict=True)
)
SIMULATED = "data: {simulate: {train: [{excitation: %s}]}}"
CONFIGS = {
    "aliases of aliases": LAUGHS + "data: {recordings: *i}",
    "aliases of aliases in a mapping": LAUGHS + "model: {thresholds: *i}",
    "an alias of itself": "data: &a {recordings: *a}",
    "an alias of nothing": "data: *a",
    "an anchor that is merged": "model: &m {plays: 3, <<: *m}",
    "a megabyte": "data: {recordings: [" + "x, " * 500_000 + "]}",
    "deep lists": "data: " + 5000 * "[",
    "deep mappings": "data: " + 3000 * "{a: ",
    "an object": "data: !!python/object/apply:os.mkdir [target]",
    "a module": "data: !!python/module:os",
    "a class": "model: {class_path: pathlib.Path, init_args: {args: [target]}}",
    "a tag": "model: !!binary aGVsbG8=",
    "two documents": "model: {plays: 3}\n---\nmodel: {plays: 4}",
    "a tab": "model:\n\tplays: 3",
    "bytes": "model: \x00",
    "nothing": "",
    "a number": "3",
    "a list": "[1, 2]",
    "null sections": "model: null\ndata: null\ntrainer: null",
    "a key twice": "model: {plays: 3}\nmodel: {plays: 4}",
    "a key of a list": "? [1, 2]\n: 3",
    "an unknown section": "modle: {plays: 3}",
    "a long key": "x" * 50_000 + ": 1",
    "many plays": "model: {plays: 100000000000}",
    "plays in floating point": "model: {plays: 1e11}",
    "no plays": "model: {plays: 0}",
    "negative plays": "model: {plays: -3}",
    "infinite plays": "model: {plays: .inf}",
    "plays as words": "model: {plays: many}",
    "many thresholds": "model: {thresholds: [" + ", ".join(map(str, range(900))) + "]}",
    "thresholds of nothing": "model: {thresholds: []}",
    "thresholds that fall": "model: {thresholds: [3, 2, 1]}",
    "thresholds that are none": "model: {thresholds: [.nan, .inf, -1]}",
    "huge thresholds": "model: {thresholds: [0, 1e308]}",
    "a high degree": "model: {degree: 1000000000}",
    "no degree": "model: {degree: 0}",
    "a high output degree": "model: {output_degree: 1000000000}",
    "a long preview": "model: {preview: 1000000000}",
    "a negative preview": "model: {preview: -1}",
    "many relaxations": "model: {creep_time_constants_s: [" + "1.0, " * 900 + "]}",
    "a list too long to parse": "data: {recordings: [" + "a.csv, " * 20_000 + "]}",
    "a relaxation of nothing": "model: {creep_time_constants_s: [0]}",
    "a relaxation that is none": "model: {creep_time_constants_s: [.nan]}",
    "a large head": "model: {rate: neural, hidden: 1000000000}",
    "a negative head": "model: {rate: neural, hidden: -1}",
    "limits that cross": "model: {min_voltage_v: 5, max_voltage_v: 1}",
    "limits that are none": "model: {min_voltage_v: .nan}",
    "infinite limits": "model: {max_voltage_v: .inf}",
    "a learning rate that is none": "model: {optimizer: adam, learning_rate: .nan}",
    "no iterations": "model: {iterations: 0}",
    "a stage that is a device": "model: {stage: /dev/zero}",
    "a stage that is a folder": "model: {stage: .}",
    "no epochs": "trainer: {max_epochs: 0}",
    "epochs that are none": "trainer: {max_epochs: .nan}",
    "many devices": "trainer: {lightning: {devices: 1000}}",
    "many devices as text": "trainer: {lightning: {devices: '1000'}}",
    "many named devices": "trainer: {lightning: {devices: [" + ", ".join(map(str, range(1000))) + "]}}",
    "no devices": "trainer: {lightning: {devices: 0}}",
    "many nodes": "trainer: {lightning: {num_nodes: 1000000}}",
    "an unknown accelerator": "trainer: {lightning: {accelerator: quantum}}",
    "an unknown strategy": "trainer: {lightning: {strategy: luck}}",
    "a precision of nothing": "trainer: {lightning: {precision: '3'}}",
    "another folder": "trainer: {lightning: {default_root_dir: 3}}",
    "figures at every none": "trainer: {figures_every: 0}",
    "a stretch that is none": "data: {evaluate_s: [.nan, .nan]}",
    "a stretch backwards": "data: {evaluate_s: [0.9, 0.1]}",
    "a stretch beyond": "data: {zero_s: [1e300, 1e301]}",
    "no bandwidth": "data: {bandwidth_hz: 0}",
    "a tiny bandwidth": "data: {bandwidth_hz: 1e-300}",
    "a huge bandwidth": "data: {bandwidth_hz: 1e300}",
    "windows of nothing": "data: {window_samples: 0}",
    "a recording that is a device": "data: {recordings: [/dev/zero]}",
    "a recording that is a folder": "data: {recordings: [.]}",
    "a rate of nothing": "data: {fs_hz: 0}",
    "a huge rate": "data: {fs_hz: 1e300}",
    "everything skipped": "data: {skip_s: 1e300}",
    "a long simulation": SIMULATED % "sine_5hz, duration_s: 1e12",
    "an endless simulation": SIMULATED % "sine_5hz, duration_s: .inf",
    "a simulation of no time": SIMULATED % "hold, duration_s: 0",
    "a long approach": SIMULATED % "hold, options: {ramp_in_s: 1e12}",
    "many stairs": SIMULATED % "stairs, options: {steps: 1000000000000}",
    "many minor loops": SIMULATED % "triangles, options: {minor_loops: 1000000000000}",
    "many periods": SIMULATED % "multisine, options: {periods: 1000000000000}",
    "an excitation of another kind": SIMULATED % "luck",
    "a seed of no size": "seed_everything: 100000000000000000000000000",
    "a seed below nothing": "seed_everything: -1",
    "a checkpoint that is a device": "ckpt_path: /dev/zero",
    "a checkpoint that is a folder": "ckpt_path: .",
}


class TrainingBegins(BaseException):
    """The settings are good enough to train with."""


def begins(*args: object, **options: object) -> None:
    raise TrainingBegins


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = tmp_path_factory.mktemp("recordings")
    return [write(folder, recording(f"r{seed}", seed, seconds=0.3)) for seed in range(2)]


@pytest.mark.parametrize("name", CONFIGS)
def test_any_config_trains_or_is_refused_in_one_line(
    name: str,
    recordings: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hostile.yaml").write_text(CONFIGS[name])
    arguments = ["fit", "--trainer.max_epochs=1", "--model.plays=3", "--config=hostile.yaml", "--output=run"]
    if "simulate" not in CONFIGS[name] and "recordings" not in CONFIGS[name]:
        arguments.insert(1, f"--data.recordings={json.dumps(recordings)}")
    monkeypatch.setattr(Trainer, "fit", begins)
    with limited():
        try:
            code = main(arguments)
        except TrainingBegins:
            return
    error = capsys.readouterr().err
    lines = [line for line in error.splitlines() if not line.startswith("torchpi: warning: ")]
    assert code == 2 and len(lines) == 1 and lines[0].startswith("torchpi: error: "), error[:3000]
    assert len(lines[0]) < 2000, lines[0]
    assert [path.name for path in tmp_path.iterdir()] == ["hostile.yaml"]
