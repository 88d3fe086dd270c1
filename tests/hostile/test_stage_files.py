"""Stage files that are damaged, modified or absurd are refused in one line; none of their code runs."""

import random
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from tests.hostile.limits import limited
from torchpi.errors import ArtifactError, ConfigError, TorchpiError
from torchpi.excitation.limits import DriveLimits
from torchpi.excitation.sets import diagnostic_excitations
from torchpi.stage import Stage
from torchpi.stage.file import HASH

HYSTERESIS = {"thresholds_v": [0.0, 0.5], "weights": [0.6, 0.2, 0.0]}
IDENTIFIED = {
    "recordings_sha256": "0" * 64,
    "heldout": "a.csv",
    "heldout_rms_um": 0.01,
    "heldout_max_um": 0.1,
}


def stage() -> Stage:
    return Stage(
        1e4,
        HYSTERESIS,
        [{"name": "delay", "values": {"delay_s": 1e-4}}],
        noise_um=0.003,
        identified=IDENTIFIED,
    )


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("stage") / "stage.pt"
    stage().save(path)
    return path.read_bytes()


def refused(path: Path) -> str:
    with pytest.raises(ArtifactError) as caught:
        Stage.load(path)
    text = str(caught.value)
    assert "\n" not in text and str(path) in text
    return text


def test_equal_stages_give_identical_bytes_without_temporary_names(good: bytes, tmp_path: Path) -> None:
    stage().save(tmp_path / "other.pt")
    assert (tmp_path / "other.pt").read_bytes() == good
    assert b".stage-" not in good


@pytest.mark.parametrize("seed", range(10))
def test_one_flipped_bit_is_refused_or_changes_nothing(seed: int, good: bytes, tmp_path: Path) -> None:
    content, rng = bytearray(good), random.Random(seed)
    content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    path = tmp_path / "stage.pt"
    path.write_bytes(content)
    try:
        loaded = Stage.load(path)
    except ArtifactError as error:
        assert "\n" not in str(error)
    else:
        assert loaded.to_dict() == stage().to_dict()


@pytest.mark.parametrize(
    "change",
    [
        lambda saved: saved["hysteresis"]["weights"].__setitem__(0, 0.7),
        lambda saved: saved.update(max_voltage_v=1000.0),
        lambda saved: saved["identified"].update(heldout_rms_um=1e-6),
        lambda saved: saved.update({HASH: 3}),
        lambda saved: saved.pop("noise_um"),
    ],
)
def test_a_modified_file_is_refused(
    change: Callable[[dict[str, Any]], object], good: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "stage.pt"
    path.write_bytes(good)
    saved = torch.load(path, weights_only=True)
    change(saved)
    torch.save(saved, path)
    assert "changed since it was written" in refused(path)


@pytest.mark.parametrize(
    "settings",
    [
        {"sample_rate_hz": "fast"},
        {"sample_rate_hz": None},
        {"hysteresis": 3},
        {"hysteresis": {"weights": "x"}},
        {"noise_um": "loud"},
        {"effects": 3},
        {"effects": [3]},
        {"effects": [{"name": 3}]},
        {"sensor": {"name": "lag"}},
        {"effects": [{"name": "delay", "values": {"delay_s": "soon"}}]},
        {"saturates": 1},
        {"identified": 3},
        {"identified": {**IDENTIFIED, "recordings_sha256": "short"}},
        {"identified": {**IDENTIFIED, "heldout": 3}},
        {"identified": {**IDENTIFIED, "each_sha256": 3}},
        {"identified": {**IDENTIFIED, "each_sha256": ["0" * 64] * 51}},
        {"identified": {**IDENTIFIED, "heldout_rms_um": "small"}},
        {"identified": {"heldout": "a.csv"}},
        {"no_such": 1},
        {"command_converter": [1]},
    ],
)
def test_invalid_values_are_refused_in_one_line(
    settings: dict[str, Any], good: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "stage.pt"
    path.write_bytes(good)
    saved = torch.load(path, weights_only=True) | settings
    del saved[HASH]
    torch.save(saved, path)
    refused(path)


LAUGHS = "".join(
    f"{name}: &{name} [{', '.join([value] * 9)}]\n"
    for name, value in zip("abcdefghi", ["1", *(f"*{one}" for one in "abcdefgh")], strict=True)
)
PLAYS = "[" + ", ".join(map(str, range(20_000))) + "]"
DELAYED = "effects: [{name: delay, values: {delay_s: %s}}]\nhysteresis: {thresholds_v: [0], weights: [1, 0]}"
STAGES = {
    "aliases of aliases": LAUGHS + "sample_rate_hz: *i",
    "an alias of itself": "sample_rate_hz: 1e4\nactuator: &a {thresholds_v: [*a]}",
    "two megabytes": "sample_rate_hz: 1e4\n#" + "x" * 2_000_000,
    "a rate of 1e300 Hz": "sample_rate_hz: 1e300",
    "no rate": "sample_rate_hz: 0",
    "a delay of 1e9 s": "sample_rate_hz: 1e4\namplifier: {delay_s: 1e9}",
    "a delay in many samples": "sample_rate_hz: 1e8\n" + DELAYED % "1",
    "a delay of no number": "sample_rate_hz: 1e4\n" + DELAYED % ".nan",
    "creep from 1e-300 s": "sample_rate_hz: 1e4\nactuator: {creep_per_decade: 0.01, creep_from_s: 1e-300}",
    "creep to 1e300 s": "sample_rate_hz: 1e4\nactuator: {creep_per_decade: 0.01, creep_to_s: 1e300}",
    "many plays": f"sample_rate_hz: 1e4\nactuator: {{thresholds_v: {PLAYS}, weights_um_per_v: {PLAYS}}}",
    "many effects": "sample_rate_hz: 1e4\nhysteresis: {thresholds_v: [0], weights: [1, 0]}\neffects:\n"
    + "- {name: resonance, values: {frequency_hz: 500, damping_ratio: 0.1}}\n" * 2000,
    "a degree of 1e9": "sample_rate_hz: 1e4\nhysteresis: {thresholds_v: [0], weights: [1], degree: 1e9}",
    "a seed of 1e30": "sample_rate_hz: 1e4\nseed: 1e30",
    "many bits": "sample_rate_hz: 1e4\namplifier: {converter_bits: 1000000000}",
    "a mode beyond all rates": "sample_rate_hz: 1e4\nmechanics: {frequency_hz: 1e300, damping_ratio: 0.1}",
    "an object": "sample_rate_hz: !!python/object/apply:os.mkdir [target]",
}


@pytest.mark.parametrize("name", STAGES)
def test_any_yaml_simulates_or_is_refused_in_one_line(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("stage.yaml").write_text(STAGES[name])
    with limited():
        try:
            Stage.from_yaml("stage.yaml").simulate(torch.ones(1, 100, dtype=torch.float64))
        except TorchpiError as error:
            text = str(error)
            assert text.startswith("stage.yaml") and "\n" not in text and len(text) < 2000
    assert not Path("target").exists()


@pytest.mark.parametrize("path", ["/dev/zero", "."])
def test_a_path_that_is_not_a_stage_file_is_refused(path: str) -> None:
    with limited(), pytest.raises(ConfigError, match=re.escape(path)):
        Stage.from_yaml(path)


@pytest.mark.parametrize(
    "limits",
    [
        {"sample_rate_hz": 1e12},
        {"max_rate_v_s": 1e-9},
        {"high_hz": 1e-9},
        {"max_voltage_v": 1e300},
        {"sample_rate_hz": float("nan")},
        {"min_voltage_v": -1e300},
    ],
)
def test_a_diagnostic_set_with_absurd_limits_is_refused(limits: dict[str, float]) -> None:
    with limited(), pytest.raises(ConfigError, match=next(iter(limits)) + "|max_rate_v_s"):
        diagnostic_excitations(DriveLimits(**limits))


def test_a_file_of_an_earlier_version_without_a_hash_is_read(good: bytes, tmp_path: Path) -> None:
    path = tmp_path / "stage.pt"
    path.write_bytes(good)
    saved = torch.load(path, weights_only=True)
    del saved[HASH], saved["identified"]
    torch.save(saved, path)
    assert Stage.load(path).identified is None
