"""The page on adding an effect is correct: its class and row suffice for a diagnosis to name the effect."""

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

from tests.diagnosis.plants import FS_HZ, pair
from torchpi.diagnosis import hypothesis, search
from torchpi.diagnosis.diagnose import diagnose
from torchpi.stage import effect_settings
from torchpi.stage.effects.effect import Effect
from torchpi.stage.effects.sensor.sensor_lag import SensorLag

PAGE = Path(__file__).parents[2] / "docs" / "adding_an_effect.md"
LEAD_S = 1e-3


@pytest.fixture
def page(tmp_path: Path) -> ModuleType:
    """Return the Python code of the page as one module, whose source TorchScript can read."""
    path = tmp_path / "rate_pickup.py"
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    path.write_text("\n\n".join(blocks), encoding="utf-8")
    spec = importlib.util.spec_from_file_location("rate_pickup", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["rate_pickup"] = module
    spec.loader.exec_module(module)
    return module


def test_the_effect_of_the_page_obeys_the_laws(page: ModuleType) -> None:
    laws = page.TestRatePickup()
    checks = [getattr(laws, name) for name in dir(laws) if name.startswith("test_")]
    assert len(checks) >= 8
    for check in checks:
        check()
    x = torch.randn(1, 50, dtype=torch.float64)
    assert torch.equal(page.RatePickup(1e-3)(x)[0], x)


def test_a_class_and_a_row_are_enough_for_an_effect_to_be_named(
    page: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The recordings are made with a backward difference of the samples, not with the class under test."""
    place = search.EFFECTS.index(SensorLag)
    effects: tuple[type[Effect], ...] = (
        *search.EFFECTS[:place],
        page.RatePickup,
        *search.EFFECTS[place:],
    )
    for module in (hypothesis, effect_settings):  # the order of the chain
        monkeypatch.setattr(module, "EFFECTS", effects)

    def pick_up(x: np.ndarray, fs_hz: float) -> np.ndarray:
        return x + LEAD_S * np.diff(x, prepend=0.0) * FS_HZ

    found = diagnose(pair(after=pick_up), effects=effects)
    (effect,) = found.effects
    assert effect.name == "rate_pickup" and found.verdict == "explained"
    assert effect.parameters[0].value == pytest.approx(LEAD_S, rel=0.02)
    assert found.stage.names == ("rate_pickup",)
