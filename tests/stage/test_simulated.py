"""A stage that corrects a simulation: what it calls, what its file holds, what it refuses."""

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.simulators.own_model import simulate
from torchpi.errors import StageError
from torchpi.operators.conformance import wandering
from torchpi.simulators import Simulator
from torchpi.stage import Stage

FS_HZ = 1000.0
CREEP = {"name": "creep", "values": {"per_decade": 0.02}}
DELAY = {"name": "delay", "values": {"delay_s": 2e-3}}


def correcting(
    reference: str = "tests.simulators.own_model:simulate", alignment: int = 0, *effects: dict
) -> Stage:
    """Return a stage of the simulation with a gain of 1.1, a play in parallel, and effects."""
    hysteresis = {
        "thresholds_v": [0.0, 0.5],
        "weights": [0.02, 0.1, 0.0],
        "simulation": {"reference": reference, "gain": 1.1},
    }
    return Stage(FS_HZ, hysteresis, effects, alignment=alignment)


def test_the_output_is_the_scaled_simulation_plus_a_correction() -> None:
    stage = correcting().with_simulation(Simulator.of(simulate))
    u = wandering(2, 300)
    alone = stage.plain().to_dict()
    alone["hysteresis"] = {k: v for k, v in alone["hysteresis"].items() if k != "simulation"}
    expected = Stage.from_dict(alone)(u)[0] + 1.1 * torch.tensor(
        np.array([simulate(row, FS_HZ) for row in u.numpy()])
    )
    torch.testing.assert_close(stage(u)[0], expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("alignment", [-1, 0, 1])
def test_delay_and_alignment_act_after_a_simulation_that_is_called_once(alignment: int) -> None:
    (u,), calls = wandering(1, 300), []

    def counted(u_v: np.ndarray, fs_hz: float) -> np.ndarray:
        calls.append(u_v)
        return simulate(u_v, fs_hz)

    simulator = Simulator.of(counted)
    y = correcting().with_simulation(simulator)(u[None])[0][0]
    moved = correcting("f", alignment, DELAY).with_simulation(simulator)(u[None])[0][0]
    late = 2 + alignment
    torch.testing.assert_close(moved[10:], y[10 - late : len(y) - late], rtol=0, atol=1e-12)
    assert len(calls) == 1


def test_its_file_names_the_simulation_and_holds_no_code(tmp_path: Path) -> None:
    stage = correcting("f:g", 1, CREEP).with_simulation(Simulator.of(simulate))
    stage.save(tmp_path / "stage.pt")
    content = torch.load(tmp_path / "stage.pt", weights_only=True)
    assert content["hysteresis"]["simulation"] == {"reference": "f:g", "gain": 1.1}
    loaded = Stage.load(tmp_path / "stage.pt")
    assert loaded.simulation == "f:g"
    with pytest.raises(StageError, match="found only its name, expected --simulation f:g"):
        loaded(wandering(1, 100))
    u = wandering(1, 100)
    again = loaded.with_simulation(Simulator.of(simulate)).at_sample_rate(FS_HZ)
    torch.testing.assert_close(again(u)[0], stage(u)[0], rtol=0, atol=0)


def test_a_recorded_simulation_output_is_taken_as_an_auxiliary_signal() -> None:
    stage, (u, simulated) = correcting("column"), wandering(2, 300)
    assert stage.aux_names == ("simulated_um",)
    y = stage(u[None], None, {"simulated_um": simulated[None]})[0]
    none = stage(u[None], None, {"simulated_um": 0 * simulated[None]})[0]
    torch.testing.assert_close(y - none, 1.1 * simulated[None], rtol=0, atol=1e-14)
    with pytest.raises(StageError, match="simulation: found no signal 'simulated_um'"):
        stage(u[None])
    with pytest.raises(StageError, match="found only a voltage"):
        stage.simulate(u[None])


def test_unsupported_uses_of_a_simulation_are_refused() -> None:
    stage, u = correcting().with_simulation(Simulator.of(simulate)), wandering(1, 100)
    _, state = stage(u)
    with pytest.raises(StageError, match="expected a whole record from rest"):
        stage(u, state)
    with pytest.raises(StageError, match="found a gradient through it"):
        stage(u.clone().requires_grad_())
    with pytest.raises(StageError, match="expected a stage that steps sample by sample"):
        stage.stream()
    with pytest.raises(StageError, match="alignment: found -1, expected 0 or 1"):
        Stage(FS_HZ, {"thresholds_v": [0.0], "weights": [1.0, 0.0]}, alignment=-1)
    with pytest.raises(StageError, match="calls no simulation"):
        correcting("column").with_simulation(Simulator.of(simulate))
