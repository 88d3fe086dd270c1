"""Stage files that are damaged, changed, or of other types: one line, and nothing runs."""

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from torchpi.errors import ArtifactError
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


def test_equal_stages_leave_equal_bytes_that_hold_no_temporary_name(good: bytes, tmp_path: Path) -> None:
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
def test_a_file_that_was_changed_is_refused(
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
        {"sample_rate_hz": "fast"}, {"sample_rate_hz": None}, {"hysteresis": 3},
        {"hysteresis": {"weights": "x"}}, {"noise_um": "loud"},
        {"effects": 3}, {"effects": [3]}, {"effects": [{"name": 3}]}, {"sensor": {"name": "lag"}},
        {"effects": [{"name": "delay", "values": {"delay_s": "soon"}}]}, {"saturates": 1},
        {"identified": 3}, {"identified": {**IDENTIFIED, "recordings_sha256": "short"}},
        {"identified": {**IDENTIFIED, "heldout": 3}},
        {"identified": {**IDENTIFIED, "heldout_rms_um": "small"}},
        {"identified": {"heldout": "a.csv"}}, {"no_such": 1}, {"command_converter": [1]},
    ],
)  # fmt: skip
def test_values_of_other_types_are_refused_in_one_line(
    settings: dict[str, Any], good: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "stage.pt"
    path.write_bytes(good)
    saved = torch.load(path, weights_only=True) | settings
    del saved[HASH]
    torch.save(saved, path)
    refused(path)


def test_a_file_of_an_earlier_version_without_a_hash_is_read(good: bytes, tmp_path: Path) -> None:
    path = tmp_path / "stage.pt"
    path.write_bytes(good)
    saved = torch.load(path, weights_only=True)
    del saved[HASH], saved["identified"]
    torch.save(saved, path)
    assert Stage.load(path).identified is None
