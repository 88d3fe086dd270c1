"""Every shipped recipe is one that the command accepts."""

from pathlib import Path

import pytest
import yaml

from train.cli import main

CONFIGS = sorted(Path("configs").glob("*.yaml"))


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
