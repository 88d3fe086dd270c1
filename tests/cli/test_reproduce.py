"""`torchpi reproduce` produces all promised results, checks names, and resumes an interrupted run."""

import json
import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from tests.paper.short_run import QUICK, STAGE, short_run
from torchpi.cli.reproduce import chosen, reproduce
from torchpi.errors import ConfigError, StageError
from torchpi.paper import items
from torchpi.paper.context import FULL, SHORT, Context, Item
from torchpi.paper.fig13 import FREQUENCIES_HZ
from torchpi.paper.result import Row
from torchpi.paper.stored import restore, store


@pytest.fixture(scope="module")
def results() -> dict[str, Any]:
    return json.loads((short_run() / "results.json").read_text(encoding="utf-8"))


def test_results_have_every_promised_key(results: dict[str, Any]) -> None:
    keys = ["fig3.round_trip"]
    keys += [f"fig7.area.{hz}" for hz in (1, 5, 10, 50, 100)]
    keys += [f"fig8.{way}_max_percent.{hz}" for way in ("indirect", "direct") for hz in (5, 10, 50, 100)]
    keys += [f"calibration.{what}.max_um" for what in ("model", "slow", "fast")]
    sizes = ("max_um", "rms_um", "max_percent", "rms_percent", "max_um_after_loading")
    for method in ("paper", "torchpi"):
        keys += [f"fig12.{method}.{name}.{size}" for name in ("slow", "fast") for size in sizes]
    keys += [f"fig13.{when}.{hz}.width_percent" for when in ("before", "after") for hz in SHORT.fig13_hz]
    keys += [f"unseen.{which}.max_percent" for which in ("median", "worst")]
    for key in keys:
        value = results
        for level in key.split("."):
            value = value[level]
        assert isinstance(value, float) and np.isfinite(value), key


def test_the_full_run_covers_1_to_80_hz_and_ten_unseen_trajectories() -> None:
    assert (min(FULL.fig13_hz), max(FULL.fig13_hz)) == (1, 80) == (FREQUENCIES_HZ[0], FREQUENCIES_HZ[-1])
    assert FULL.unseen == 10


def test_the_numbers_of_the_paper_are_reproduced(results: dict[str, Any]) -> None:
    assert results["fig3"]["round_trip"] < 1e-12
    areas = list(results["fig7"]["area"].values())
    assert areas == sorted(areas)
    for hz, percent in {"5": 0.26, "10": 0.56, "50": 4.2, "100": 11.6}.items():
        assert results["fig8"]["indirect_max_percent"][hz] == pytest.approx(percent, rel=0.1)
    for what, max_um in {"model": 0.21, "slow": 0.22, "fast": 0.23}.items():
        assert results["calibration"][what]["max_um"] == pytest.approx(max_um, rel=0.2)


def test_every_method_has_a_row_with_all_its_numbers(results: dict[str, Any]) -> None:
    table = results["more"]["methods"]
    assert len(table) == 9
    for name, row in table.items():
        assert list(row["fig7_max_percent"]) == ["5", "10", "50", "100"]
        if name != "known_plant":
            for key in ("stage", "stage_with_look_ahead"):
                assert all(0 < row[key][trajectory]["max_percent"] < 50 for trajectory in ("slow", "fast"))
    without, conventional = (table[name]["stage"]["slow"] for name in ("without", "conventional"))
    assert conventional["max_percent"] < without["max_percent"]


def test_an_unknown_name_is_refused_with_the_nearest_and_all_valid_names() -> None:
    with pytest.raises(ConfigError) as refused:
        chosen(["fig88"])
    message = str(refused.value)
    assert "fig88" in message and "perhaps 'fig8'" in message and "\n" not in message
    assert all(name in message for name in items.ITEMS)
    with pytest.raises(ConfigError, match="one or more of"):
        chosen([])


def test_an_unphysical_stage_is_refused_before_anything_runs(tmp_path) -> None:
    bad = tmp_path / "bad.yaml"
    good = STAGE.read_text(encoding="utf-8")
    bad.write_text(re.sub(r"damping_ratio: [\d.]+", "damping_ratio: -0.02", good), encoding="utf-8")
    with pytest.raises(StageError, match="damping_ratio"):
        reproduce(tmp_path / "out", ["fig3"], bad, SHORT, QUICK)
    assert not (tmp_path / "out").exists()


@dataclass(frozen=True)
class Counted:
    """The result of a test item."""

    value: float
    trace: np.ndarray

    def numbers(self) -> dict[str, Any]:
        return {"fig4": {"value": self.value}}

    def rows(self) -> list[Row]:
        return [Row("value", self.value)]


@pytest.fixture
def counted(monkeypatch) -> list[str]:
    """Replace all items by three and list the names of those computed, in order; the third is interrupted."""
    calls: list[str] = []

    def compute(name: str):
        def run(context: Context) -> Counted:
            calls.append(name)
            if name == "fig5" and calls.count(name) == 1:
                raise KeyboardInterrupt
            return Counted(float(len(calls)), np.arange(3.0))

        return run

    three = {
        name: Item(name, Counted, compute(name), needs, of_the_stage=False)
        for name, needs in (("table1", ()), ("jointly", ("table1",)), ("fig5", ("jointly",)))
    }
    monkeypatch.setattr(items, "ITEMS", three)
    monkeypatch.setattr("torchpi.cli.reproduce.ITEMS", three)
    monkeypatch.setattr("torchpi.cli.reproduce.write_paper_page", lambda *given: given[3] / "paper.html")
    return calls


def test_an_interrupted_run_resumes_where_it_stopped(tmp_path, counted: list[str]) -> None:
    with pytest.raises(KeyboardInterrupt):
        reproduce(tmp_path, ["fig5"], STAGE, SHORT, QUICK)
    assert counted == ["table1", "jointly", "fig5"]
    assert not (tmp_path / "results.json").exists()
    reproduce(tmp_path, ["fig5"], STAGE, SHORT, QUICK)
    assert counted == ["table1", "jointly", "fig5", "fig5"]
    reproduce(tmp_path, None, STAGE, SHORT, QUICK)
    assert len(counted) == 4


def test_changed_inputs_and_broken_files_are_recomputed(tmp_path, counted: list[str]) -> None:
    reproduce(tmp_path, ["jointly"], STAGE, SHORT, QUICK)
    reproduce(tmp_path, ["jointly"], STAGE, replace(SHORT, unseen=3), QUICK)
    assert counted == ["table1", "jointly"] * 2
    (tmp_path / "items" / "jointly.npz").write_bytes(b"PK\x03\x04 cut short")
    reproduce(tmp_path, ["jointly"], STAGE, replace(SHORT, unseen=3), QUICK)
    assert counted == ["table1", "jointly", "table1", "jointly", "jointly"]


def test_only_requested_items_and_their_dependencies_are_computed(tmp_path, counted: list[str]) -> None:
    reproduce(tmp_path, ["table1"], STAGE, SHORT, QUICK)
    assert counted == ["table1"]
    assert json.loads((tmp_path / "results.json").read_text()) == {"fig4": {"value": 1.0}}


@dataclass(frozen=True)
class Nested:
    """Every type of value that a result may hold."""

    counted: dict[str, list[Counted]]
    pair: tuple[float, ...]
    word: str
    nothing: float | None
    free: dict[str, Any]


def test_a_stored_result_is_restored_unchanged(tmp_path) -> None:
    held = Nested({"a": [Counted(0.1, np.array([1.0, np.pi]))]}, (1.0, 2.5), "ζ", None, {"list": [1, 2]})
    store(held, "key", 1.5, tmp_path / "a.npz")
    assert restore(Nested, "another key", tmp_path / "a.npz") is None
    assert restore(Nested, "key", tmp_path / "none.npz") is None
    found = restore(Nested, "key", tmp_path / "a.npz")
    assert found is not None
    back, seconds = found
    assert seconds == 1.5
    assert (back.pair, back.word, back.nothing, back.free) == (held.pair, held.word, None, held.free)
    (one,) = back.counted["a"]
    assert one.value == 0.1
    np.testing.assert_array_equal(one.trace, held.counted["a"][0].trace)


def test_a_row_states_its_deviation_and_whether_it_is_within_its_bound() -> None:
    row = Row("a", 1.1, paper=1.0, within_percent=20)
    assert row.difference == pytest.approx(0.1) and row.difference_percent == pytest.approx(10)
    assert row.met is True
    assert Row("a", 1.3, paper=1.0, within_percent=20).met is False
    assert Row("a", 0.4, at_most=0.5).met is True
    assert Row("a", 0.4).met is None and Row("a", 0.4).difference is None
