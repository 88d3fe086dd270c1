"""Simulations by name: functions are found, called once for each voltage, and checked; so are FMUs."""

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.simulators import own_model
from torchpi.errors import SimulationError
from torchpi.simulators import Simulator, load_simulator

U_V = 5 * (1 - np.cos(np.arange(200) / 20))


def one_line(reference: str) -> str:
    """Return the one-line error with which a reference is refused."""
    with pytest.raises(SimulationError) as raised:
        load_simulator(reference)
    assert "\n" not in str(raised.value)
    return str(raised.value)


def test_a_function_is_found_by_its_module_and_name() -> None:
    found = load_simulator("tests.simulators.own_model:simulate")
    np.testing.assert_array_equal(found(U_V, 1e3), own_model.simulate(U_V, 1e3))
    assert found.source == own_model.__file__ and found.travels


def test_a_function_is_found_in_a_file_and_in_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "path", [*sys.path])
    for name in ("a_file_of_mine", "a_module_of_mine"):
        (tmp_path / f"{name}.py").write_text(
            "def simulate(u_v, fs_hz):\n    return 2 * u_v\n", encoding="utf-8"
        )
    monkeypatch.chdir(tmp_path)
    for reference in ("a_module_of_mine:simulate", f"{tmp_path}/a_file_of_mine.py:simulate"):
        np.testing.assert_array_equal(load_simulator(reference)(U_V, 1e3), 2 * U_V)


@pytest.mark.parametrize(
    ("reference", "text"),
    [
        ("simulate", "found 'simulate', expected a stage"),
        ("no_such_module:simulate", "found ModuleNotFoundError"),
        ("no_such_file.py:simulate", "found no file 'no_such_file.py'"),
        ("tests.simulators.own_model:simulator", "found no function 'simulator'"),
        ("tests.simulators.own_model:number", "found no function 'number'"),
    ],
)
def test_an_invalid_reference_is_refused_in_one_line(reference: str, text: str) -> None:
    assert text in one_line(reference)


def test_the_same_voltage_is_simulated_once() -> None:
    calls: list[float] = []

    def simulate(u_v: np.ndarray, fs_hz: float) -> np.ndarray:
        calls.append(fs_hz)
        u_v += 1.0  # changes only a copy
        return u_v

    simulator = Simulator.of(simulate)
    for fs_hz in (1e3, 1e3, 2e3):
        np.testing.assert_array_equal(simulator(U_V, fs_hz), U_V + 1.0)
    assert calls == [1e3, 2e3]


def fmpy(variables: list[tuple[str, str]], version: str = "2.0", co_simulation: bool = True) -> Any:
    """Return a stand-in for the package: the output of its FMU is half the input at the end of each step."""

    def read_model_description(path: str) -> SimpleNamespace:
        return SimpleNamespace(
            fmiVersion=version,
            coSimulation=SimpleNamespace() if co_simulation else None,
            modelVariables=[SimpleNamespace(name=name, causality=kind) for name, kind in variables],
        )

    def simulate_fmu(path: str, **given: Any) -> np.ndarray:
        held, (output,) = given["input"], given["output"]
        assert given["step_size"] == given["output_interval"] == pytest.approx(held["time"][1])
        result = np.zeros(len(held), dtype=[("time", float), (output, float)])
        result["time"] = held["time"]
        result[output][1:] = 0.5 * held["voltage"][:-1]
        return result

    module = ModuleType("fmpy")
    module.__dict__.update(read_model_description=read_model_description, simulate_fmu=simulate_fmu)
    return module


ONE_EACH = [("time", "independent"), ("voltage", "input"), ("gain", "parameter"), ("position", "output")]


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_the_output_of_an_fmu_belongs_to_the_voltage_of_the_same_sample(
    version: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "fmpy", fmpy(ONE_EACH, version))
    path = tmp_path / "stage.fmu"
    path.touch()
    found = load_simulator(str(path))
    np.testing.assert_array_equal(found(U_V, 1e3), 0.5 * U_V)
    assert found.source == str(path) and found.travels


@pytest.mark.parametrize(
    ("module", "text"),
    [
        (fmpy(ONE_EACH[:-1]), "found none as output, expected one output"),
        (fmpy([*ONE_EACH, ("second", "input")]), "found voltage, second as input, expected one input"),
        (fmpy(ONE_EACH, "1.0"), "found FMI 1.0 for co-simulation, expected FMI 2 or 3"),
        (fmpy(ONE_EACH, co_simulation=False), "found FMI 2.0 for model exchange"),
        (None, "found no package fmpy, expected it installed; pip install 'torchpi[fmi]'"),
    ],
)
def test_an_unsuitable_fmu_or_a_missing_fmpy_is_refused_in_one_line(
    module: Any, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "fmpy", module)
    path = tmp_path / "stage.fmu"
    path.touch()
    assert text in one_line(str(path))


def test_a_missing_fmu_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fmpy", fmpy(ONE_EACH))
    assert "no such file" in one_line("nowhere.fmu")
