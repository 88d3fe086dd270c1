"""A stage whose effects use their other forms: stream equals batch, and its file restores it."""

from pathlib import Path

import pytest
import torch

from torchpi.operators.conformance import wandering
from torchpi.stage import Stage

HYSTERESIS = {"thresholds_v": [0.0, 0.2, 0.7], "weights": [0.6, 0.2, 0.1, 0.0]}
FORMS = {
    "slew_limit": {"rate_v_per_s": 4e3, "knee_v": 0.3},
    "amplifier_lag": {"cutoff_hz": 900.0, "damping_ratio": 0.7},
    "delay": {"delay_s": 1.3e-4, "after_lag": 1.0},
    "rate_dependent_hysteresis": {"relaxation_s": 2e-4},
    "creep": {"power_per_decade": 0.02, "exponent": 0.3},
    "backlash": {"width_um": 0.05, "presliding_um": 0.02},
    "thermal_drift": {"amplitude_um": 0.1, "time_constant_s": 0.02, "rate_um_per_s": -0.2},
    "gain_modulation": {"frequency_hz": 20.0, "cos": 0.02, "sin_um": 0.1},
}


def stage() -> Stage:
    effects = [{"name": name, "values": values} for name, values in FORMS.items()]
    return Stage(1e4, HYSTERESIS, effects, alignment=1, noise_um=0.003)


@pytest.mark.parametrize("compiled", [False, True])
def test_stream_gives_the_same_bits_as_simulate(compiled: bool) -> None:
    one, u = stage(), wandering(1, 400)
    y, reading = one.simulate(u)
    stream = one.stream(compiled)
    stepped = torch.tensor([stream.step(command) for command in u[0].tolist()], dtype=torch.float64)
    assert torch.equal(stepped[:, 0], y[0]) and torch.equal(stepped[:, 1], reading[0])


def test_windows_with_carried_state_give_the_same_bits_as_one_pass() -> None:
    one, u = stage(), wandering(2, 300)
    whole, final = one(u)
    first, state = one(u[:, :101])
    second, state = one(u[:, 101:], state)
    assert torch.equal(torch.cat([first, second], 1), whole) and torch.equal(state, final)


def test_a_saved_stage_is_loaded_unchanged(tmp_path: Path) -> None:
    one, u = stage(), wandering(1, 300)
    one.save(tmp_path / "stage.pt")
    again = Stage.load(tmp_path / "stage.pt")
    assert again.to_dict() == one.to_dict()
    assert torch.equal(again.simulate(u)[1], one.simulate(u)[1])


def test_every_form_changes_the_output() -> None:
    u, y = wandering(1, 300), stage()(wandering(1, 300))[0]
    for name in FORMS:
        effects = [{"name": other, "values": values} for other, values in FORMS.items() if other != name]
        assert not torch.equal(Stage(1e4, HYSTERESIS, effects, alignment=1)(u)[0], y), name
