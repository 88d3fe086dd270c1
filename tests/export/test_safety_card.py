"""The safety card: facts from the model and its training, in JSON and on the page; when a flag is needed."""

import json
import re
import sys
from html import unescape
from pathlib import Path

import pytest
import torch

from tests.hostile.sequences import compensator
from torchpi.cli import commands
from torchpi.control.direct_inverse import DirectInverse
from torchpi.control.trained import to_checkpoint
from torchpi.control.trained_motions import TrainedMotions
from torchpi.errors import ConfigError
from torchpi.export import Load, export_files, load_torchscript, safety_card
from torchpi.identification.pair import InversePair
from torchpi.operators.motion import Motion


def linear(**changes: object) -> DirectInverse:
    """u = 2 y - h_1: from rest 2 V/µm up to the threshold of 1 µm, then 1 V/µm."""
    made = DirectInverse(1e-3, [0.0, 1.0], degree=1, rate="none", **changes)
    with torch.no_grad():
        made.weights.theta[:, 0] = torch.tensor([2.0, -1.0])
    return made


def test_the_reach_ends_where_the_loop_meets_the_voltage_limits() -> None:
    card = safety_card(linear())
    # Up: 2 y - (y - 1) = 10. Down from there, h_1 first stands still at 8, then follows at y + 1.
    assert card.reachable_um == pytest.approx((0.0, 9.0), abs=0.02)
    assert card.remanence_um == pytest.approx(1.0, abs=0.02)
    assert card.reachable_from_remanence_um == (card.remanence_um, card.reachable_um[1])
    assert card.monotone is None and card.trained_range_um is None and card.current_ma is None


def test_current_is_capacitance_times_gain_times_rate() -> None:
    card = safety_card(compensator(max_slew_v_s=1000.0), Load(capacitance_uf=3.4, amplifier_gain=15.0))
    assert card.current_ma == pytest.approx(1e3 * 3.4e-6 * 15.0 * 250.0)
    assert card.current_at_slew_limit_ma == pytest.approx(1e3 * 3.4e-6 * 15.0 * 1000.0)


@pytest.mark.parametrize(
    "changes", [{"capacitance_uf": 0.0}, {"capacitance_uf": -1.0}, {"amplifier_gain": 0.0}]
)
def test_an_impossible_load_is_refused(changes: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=f"{next(iter(changes))}: found"):
        Load(**changes)


def test_trained_motions_are_ranges_over_the_counted_samples() -> None:
    y = torch.tensor([[100.0, 1.0, 2.0, 4.0, -100.0]], dtype=torch.float64)
    u = torch.tensor([[50.0, 0.5, 1.0, 3.0, -50.0]], dtype=torch.float64)
    pair = InversePair("a", Motion(y, 10 * y, y), u, slice(1, 4), 0.1)
    found = TrainedMotions.of([pair])
    assert found == TrainedMotions((1.0, 4.0), (10.0, 40.0), (0.5, 3.0), (5.0, 20.0), (1.0, 4.0))
    assert TrainedMotions.from_plain(found.plain()) == found
    earlier = {name: value for name, value in found.plain().items() if name != "accelerations_um_s2"}
    assert TrainedMotions.from_plain(earlier).accelerations_um_s2 is None


def test_the_card_is_in_the_json_and_on_the_page(tmp_path: Path) -> None:
    json_file, page = export_files(compensator(), tmp_path / "demo", ("json", "page"), load=Load(3.4))
    numbers, html = json.loads(json_file.read_text()), page.read_text()
    card = safety_card(compensator(), Load(3.4))
    assert numbers["safety"] == card.as_json()
    assert numbers["guard"]["accepted_um"] == list(compensator().step_limits().accepted_um)
    for key in card.as_json():
        assert f'data-part="{key}"' in html or key.startswith("monotone")
    assert "0.001 s" in html and "-6000 … 6000 µm/s²" in html and "3.4 µF" in html
    assert card.monotone_summary in unescape(html) and f"{card.current_ma:.4g} mA" in html


def test_unknown_values_are_marked_and_the_options_that_supply_them_named(tmp_path: Path) -> None:
    [page] = export_files(linear(), tmp_path / "demo", ("page",))
    rows = dict(re.findall(r'data-part="(\w+)">.*?<td>(.*?)</td>', page.read_text(), re.DOTALL))
    assert rows["trained_voltage_rates_v_s"] == rows["trained_range_um"] == rows["current_ma"] == "not known"
    assert "--max_slew_v_s" in rows["max_slew_v_s"] and "--capacitance_uf" in rows["capacitance_uf"]


def export(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["torchpi", "export", *arguments])
    with pytest.raises(SystemExit) as ended:
        commands.main()
    return int(ended.value.code or 0)


def test_export_of_an_inverse_that_runs_backwards_needs_a_flag(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made = compensator()
    with torch.no_grad():
        made.weights.theta[3, 1] = -2.0
    torch.save(to_checkpoint(made), tmp_path / "best.ckpt")
    arguments = [str(tmp_path / "best.ckpt"), "--to", "json", "--output", str(tmp_path / "out" / "demo")]
    assert export(monkeypatch, *arguments) == 2
    error = capsys.readouterr().err
    assert "runs backwards" in error and "--allow_backwards true" in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists()
    assert export(monkeypatch, *arguments, "--allow_backwards", "true") == 0
    assert json.loads((tmp_path / "out" / "demo.json").read_text())["safety"]["monotone"] is False


def test_the_command_exports_a_slew_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    torch.save(to_checkpoint(compensator()), tmp_path / "best.ckpt")
    output = tmp_path / "demo"
    arguments = [str(tmp_path / "best.ckpt"), "--output", str(output), "--to", "torchscript"]
    assert export(monkeypatch, *arguments, "--max_slew_v_s", "100") == 0
    loaded = load_torchscript(output.with_suffix(".pt"))
    assert loaded.step(4.0) == pytest.approx(100.0 * 1e-3)
