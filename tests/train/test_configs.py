"""Every shipped recipe is one that the command accepts."""

from pathlib import Path

import pytest
import yaml

from torchpi.identification.multi_axis import MultiAxisOptions
from train import multi_axis
from train.cli import main

EVERY = sorted(Path("configs").glob("*.yaml"))
CONFIGS = [path for path in EVERY if multi_axis.SECTION not in yaml.safe_load(path.read_text())]


def test_there_are_recipes() -> None:
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
def test_every_recipe_of_several_axes_has_keys_that_are_read(path: Path) -> None:
    settings = yaml.safe_load(path.read_text())[multi_axis.SECTION]
    own = {name: value for name, value in settings.items() if name not in multi_axis.READING}
    assert MultiAxisOptions(**own)
    assert multi_axis.config_of(["fit", "--config", str(path)]) == path
