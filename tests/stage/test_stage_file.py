"""A stage as settings and in files: it is restored unchanged, and any other file is refused."""

import copy
import json
import pickle
from pathlib import Path

import pytest
import torch

from tests.stage.test_stage import COUPLING, DEFAULT, HUM, LAG, RATE, RATE_HZ, chain, operator, small, volts
from torchpi.errors import ArtifactError
from torchpi.stage import Stage
from torchpi.stage.effects import EFFECTS
from torchpi.stage.effects.amplifier.delay import Delay
from torchpi.stage.effects.effect import Effect
from torchpi.stage.effects.mechanics.resonance import Resonance


@pytest.mark.parametrize("make", [small, chain, lambda: Stage.from_dict({"sample_rate_hz": RATE_HZ})])
def test_a_changed_stage_is_restored_from_settings_file_or_copy(make, tmp_path: Path) -> None:
    stage, u = make(), volts()
    with torch.no_grad():
        for one in stage.modules():
            if isinstance(one, Resonance):
                one.frequency_hz.fill_(555.0)
            if isinstance(one, Delay):
                one.delay_s.fill_(2.2e-4)
        stage.hysteresis.weights.mul_(1.1)
        stage.hysteresis.weight_s_per_v.fill_(2e-5)
    stage.save(tmp_path / "stage.pt")
    again = [Stage.from_dict(stage.to_dict()), Stage.load(tmp_path / "stage.pt")]
    again += [copy.deepcopy(stage), pickle.loads(pickle.dumps(stage))]
    for other in again:
        assert other.to_dict() == stage.to_dict()
        assert torch.equal(other.simulate(u)[1], stage.simulate(u)[1])


def test_a_parameter_that_training_moved_off_its_identity_is_kept() -> None:
    stage = small()
    with torch.no_grad():
        operator(stage, _creep()).gain.fill_(0.03)
    assert {"name": "creep", "gain": 0.03}.items() <= _values(stage, "creep").items()
    assert _values(Stage.from_dict(stage.to_dict()), "creep")["gain"] == 0.03


def _creep() -> type[Effect]:
    (kind,) = (kind for kind in EFFECTS if kind.name == "creep")
    return kind


def _values(stage: Stage, name: str) -> dict[str, object]:
    (found,) = (one for one in stage.effects if one.kind.name == name)
    return {"name": name, **found.values}


def test_the_file_holds_plain_values_and_the_current_version(tmp_path: Path) -> None:
    one = chain(effects=[HUM, RATE, COUPLING, LAG])
    one.save(tmp_path / "stage.pt")
    plain = torch.load(tmp_path / "stage.pt", weights_only=True)
    assert (plain["schema"], plain["version"]) == ("torchpi stage", 3)
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain
    again = Stage.load(tmp_path / "stage.pt")
    assert (again.min_voltage_v, again.max_voltage_v, again.noise_um) == (0.0, 10.0, 0.003)


def test_a_yaml_file_may_have_sections_or_a_list_of_effects(tmp_path: Path) -> None:
    u = volts()
    assert torch.equal(Stage.load(DEFAULT).simulate(u)[1], Stage.from_yaml(DEFAULT).simulate(u)[1])
    path = tmp_path / "chain.yaml"
    path.write_text(json.dumps(chain().to_dict()))
    assert torch.equal(Stage.from_yaml(path).simulate(u)[1], chain().simulate(u)[1])


def test_a_file_of_another_kind_or_version_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(ArtifactError, match="no such file"):
        Stage.load(tmp_path / "none.pt")
    (tmp_path / "text.pt").write_text("no stage")
    with pytest.raises(ArtifactError, match="not a stage file"):
        Stage.load(tmp_path / "text.pt")
    torch.save({"weights": torch.zeros(2)}, tmp_path / "other.pt")
    with pytest.raises(ArtifactError, match="a file of another kind"):
        Stage.load(tmp_path / "other.pt")
    torch.save({"schema": "torchpi augmented stage", "version": 1, "alignment": 1}, tmp_path / "older.pt")
    with pytest.raises(ArtifactError, match="found version 1, expected 3: identify the stage again"):
        Stage.load(tmp_path / "older.pt")
    plain = {"schema": "torchpi stage", "version": 3}
    damaged = [{}, {"sample_rate_hz": RATE_HZ, "hysteresis": {"plays": 3}}]
    damaged += [chain().to_dict() | {"effects": [{"name": "hums"}]}, chain().to_dict() | {"seed": -1}]
    for content in damaged:
        torch.save(plain | content, tmp_path / "damaged.pt")
        with pytest.raises(ArtifactError, match="damaged") as refusal:
            Stage.load(tmp_path / "damaged.pt")
        assert "\n" not in str(refusal.value)
