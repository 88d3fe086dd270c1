"""The command accepts every shipped recipe."""

from pathlib import Path

import pytest
import yaml

from torchpi.identification.bouc_wen_oscillator import OscillatorOptions
from torchpi.identification.multi_axis import MultiAxisOptions
from train import multi_axis, oscillator
from train.cli import main
from train.own_kind import config_with

EVERY = sorted(Path("configs").glob("*.yaml"))
OWN_KIND = {multi_axis: MultiAxisOptions, oscillator: OscillatorOptions}
SECTIONS = {kind.SECTION for kind in OWN_KIND}
CONFIGS = [path for path in EVERY if not SECTIONS & set(yaml.safe_load(path.read_text()))]


def test_the_expected_recipes_exist() -> None:
    assert {path.stem for path in CONFIGS} >= {"demo", "recorded", "piezo_stack"}


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_every_recipe_parses_and_keeps_its_values(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["fit", "--config", str(path), "--print_config"])
    assert ended.value.code in (0, None)
    resolved = yaml.safe_load(capsys.readouterr().out)
    for group, options in yaml.safe_load(path.read_text()).items():
        if isinstance(options, dict):
            assert options.keys() <= resolved[group].keys()
        else:
            assert resolved[group] == options


@pytest.mark.parametrize("path", sorted({*EVERY} - {*CONFIGS}), ids=lambda path: path.stem)
def test_every_multi_axis_or_oscillator_recipe_has_only_known_keys(path: Path) -> None:
    (section,) = yaml.safe_load(path.read_text()).items()
    (kind,) = (one for one in OWN_KIND if one.SECTION == section[0])
    own = {name: value for name, value in section[1].items() if name not in kind.READING}
    assert OWN_KIND[kind](**own)
    assert config_with(kind.SECTION, ["fit", "--config", str(path)]) == path
