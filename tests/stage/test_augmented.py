"""The augmented stage: the chain that was fitted, as a file, as a rig, and for gradients."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from torchpi.errors import ArtifactError, StageError
from torchpi.loop import run_loop
from torchpi.loop_result import COMPENSATED
from torchpi.operators.conformance import wandering
from torchpi.stage import AugmentedStage
from torchpi.stage.effects import EFFECTS
from torchpi.stage.effects.amplifier.amplifier_lag import AmplifierLag
from torchpi.stage.effects.mechanics.resonance import Resonance
from torchpi.stage.effects.sensor.hum import Hum
from torchpi.stage.hysteresis import Hysteresis

PERIOD_S = 1e-4
HYSTERESIS = {"thresholds_v": [0.0, 0.2, 0.7], "weights": [0.6, 0.2, 0.1, 0.0]}
RESONANCE = {"name": "resonance", "values": {"frequency_hz": 400.0, "damping_ratio": 0.02}}
LAG = {"name": "amplifier_lag", "values": {"cutoff_hz": 900.0}}
HUM = {"name": "hum", "values": {"frequency_hz": 50.0, "cos_um": 0.01, "sin_um": 0.02}}
RATE = {"name": "rate_dependent_hysteresis", "values": {"weight_s_per_v": 1e-5}}
COUPLING = {"name": "cross_coupling", "values": {"coupling_um_per_v": 0.1}, "aux": "aux_v"}


def stage(**changes: object) -> AugmentedStage:
    settings = {"effects": [HUM, RESONANCE, RATE, LAG], "alignment": 1, "noise_um": 0.003}
    settings |= {"min_voltage_v": 0.0, "max_voltage_v": 10.0, **changes}
    return AugmentedStage(PERIOD_S, HYSTERESIS, **settings)  # type: ignore[arg-type]


def test_effects_stand_in_the_order_of_the_chain() -> None:
    u = wandering(2, 400)
    late = torch.cat([torch.zeros(2, 1), u[:, :-1]], 1)
    with torch.no_grad():
        v, _ = AmplifierLag(PERIOD_S, cutoff_hz=900.0)(late)
        y, _ = Hysteresis(PERIOD_S, **HYSTERESIS, shape={"weight_s_per_v": 1e-5})(v)
        y, _ = Resonance(PERIOD_S, frequency_hz=400.0, damping_ratio=0.02)(y)
        y, _ = Hum(PERIOD_S, **HUM["values"])(y)
        assert torch.equal(stage()(u)[0], y)
    assert stage().names == ("amplifier_lag", "rate_dependent_hysteresis", "resonance", "hum")


def test_with_every_effect_at_its_identity_it_is_the_hysteresis() -> None:
    every = [{"name": e.name, "values": {}, "aux": "aux_v" if e.takes_aux else ""} for e in EFFECTS]
    u = wandering(1, 300)
    with torch.no_grad():
        y, _ = stage(effects=every, alignment=0)(u, None, {"aux_v": u})
        assert torch.equal(y, Hysteresis(PERIOD_S, **HYSTERESIS)(u)[0])


@pytest.mark.parametrize("alignment", [0, 1])
def test_windows_with_carried_state_give_the_same_bits(alignment: int) -> None:
    one, u, aux = (
        stage(effects=[LAG, COUPLING, HUM], alignment=alignment),
        wandering(2, 300),
        wandering(2, 300, 1),
    )
    with torch.no_grad():
        whole, final = one(u, None, {"aux_v": aux})
        parts, state = [], None
        for part in (slice(0, 101), slice(101, 102), slice(102, 300)):
            y, state = one(u[:, part], state, {"aux_v": aux[:, part]})
            parts.append(y)
    assert torch.equal(torch.cat(parts, 1), whole) and torch.equal(state, final)


def test_the_rig_steps_through_the_same_bits_as_it_simulates() -> None:
    one, u = stage(effects=[LAG, RATE, COUPLING, RESONANCE, HUM]), wandering(1, 500)
    with torch.no_grad():
        y, reading = one.simulate(u, seed=5)
    rig = one.stream()
    for _ in range(2):
        rig.reset(5)
        stepped = np.array([rig.step(sample) for sample in u[0].tolist()])
        np.testing.assert_array_equal(stepped, torch.stack([y[0], reading[0]], 1).numpy())
    assert float((reading - y).std()) == pytest.approx(0.003, rel=0.2)


def test_the_file_is_plain_and_gives_the_stage_again(tmp_path: Path) -> None:
    one, u = stage(effects=[HUM, RATE, COUPLING, LAG]), wandering(1, 200)
    with torch.no_grad():
        one.hysteresis.weights.mul_(1.1)
        one.hysteresis.weight_s_per_v.mul_(2.0)
    one.save(tmp_path / "stage.pt")
    plain = torch.load(tmp_path / "stage.pt", weights_only=True)
    assert plain["version"] == 1 and json.loads(json.dumps(plain)) == plain
    again = AugmentedStage.load(tmp_path / "stage.pt")
    assert torch.equal(again(u, None, {"aux_v": u})[0], one(u, None, {"aux_v": u})[0])
    assert (again.min_voltage_v, again.max_voltage_v, again.noise_um) == (0.0, 10.0, 0.003)
    assert again.to_dict() == one.to_dict()


def test_another_file_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(ArtifactError, match="no such file"):
        AugmentedStage.load(tmp_path / "none.pt")
    (tmp_path / "text.pt").write_text("no stage")
    with pytest.raises(ArtifactError, match="not a stage file"):
        AugmentedStage.load(tmp_path / "text.pt")
    torch.save({"weights": torch.zeros(2)}, tmp_path / "other.pt")
    with pytest.raises(ArtifactError, match="something else"):
        AugmentedStage.load(tmp_path / "other.pt")
    stage().save(tmp_path / "newer.pt")
    torch.save(torch.load(tmp_path / "newer.pt") | {"version": 2}, tmp_path / "newer.pt")
    with pytest.raises(ArtifactError, match="found version 2, want 1"):
        AugmentedStage.load(tmp_path / "newer.pt")
    torch.save({"schema": "torchpi augmented stage", "version": 1}, tmp_path / "empty.pt")
    with pytest.raises(ArtifactError, match="damaged"):
        AugmentedStage.load(tmp_path / "empty.pt")


def test_gradients_are_those_of_finite_differences() -> None:
    one, u, aux = stage(effects=[LAG, RATE, COUPLING, RESONANCE]), 1 + wandering(1, 30), wandering(1, 30, 1)
    one.hysteresis.asymmetry_per_v.requires_grad_(False)
    names, parameters = zip(*one.named_parameters(), strict=True)

    def output(u: Tensor, *values: Tensor) -> Tensor:
        inputs = (u, None, {"aux_v": aux})
        return torch.func.functional_call(one, dict(zip(names, values, strict=True)), inputs)[0]

    inputs = [u.requires_grad_(), *(p.detach().clone().requires_grad_(p.requires_grad) for p in parameters)]
    assert torch.autograd.gradcheck(output, inputs, eps=1e-6, atol=1e-5)


def test_one_set_of_parameters_serves_two_sample_rates() -> None:
    slow = stage(effects=[RESONANCE, HUM], alignment=0)
    fast = slow.at_sample_rate(1e5)
    assert fast.sample_rate_hz == pytest.approx(1e5)
    t = torch.arange(4000, dtype=torch.float64)[None] / 1e5
    u = 2 - 2 * torch.cos(2 * np.pi * 5 * t)
    with torch.no_grad():
        torch.testing.assert_close(fast(u)[0][:, ::10], slow(u[:, ::10])[0], rtol=0, atol=2e-3)


def test_the_plain_stage_is_its_hysteresis_alone() -> None:
    u = wandering(1, 200)
    with torch.no_grad():
        plain = stage(alignment=0).plain()
        assert torch.equal(plain(u)[0], Hysteresis(PERIOD_S, **HYSTERESIS)(u)[0])
    assert plain.names == ()


def test_what_it_cannot_use_is_refused_by_name() -> None:
    with pytest.raises(StageError, match="cross_coupling: found no signal 'aux_v'"):
        stage(effects=[COUPLING])(wandering(1, 10))
    with pytest.raises(StageError, match="effects: found 'gremlins', want one of voltage_saturation"):
        stage(effects=[{"name": "gremlins", "values": {}}])
    with pytest.raises(StageError, match="cross_coupling: found the auxiliary signal ''"):
        stage(effects=[{"name": "cross_coupling", "values": {}}])
    with pytest.raises(StageError, match="alignment: found 2"):
        stage(alignment=2)
    with pytest.raises(StageError, match="cutoff_hz"):
        stage(effects=[{"name": "amplifier_lag", "values": {"cutoff_hz": -1.0}}])
    with pytest.raises(StageError, match="weight_s_per_v"):
        stage(effects=[{"name": "rate_dependent_hysteresis", "values": {"weight_s_per_v": 9.0}}])


class Straight:
    """u = y_d / gain."""

    sample_period_s, preview = PERIOD_S, 0

    def reset(self) -> None: ...

    def step(self, yd: float) -> float:
        return yd / 0.9


def test_a_control_loop_runs_against_it() -> None:
    t = np.arange(2000) * PERIOD_S
    result = run_loop(
        Straight(), stage(), 4 - 3 * np.cos(2 * np.pi * 10 * t), fs_hz=1 / PERIOD_S, name="sine"
    )
    assert 0 < result.drives[COMPENSATED].on_true.steady.rms_um < 1


MODAL = [
    {
        "name": "resonance",
        "values": {"frequency_hz": 400.0, "damping_ratio": 0.02, "share": 0.6},
        "modal": True,
    },
    {"name": "second_mode", "values": {"frequency_hz": 900.0, "share": -0.1}, "modal": True},
    {"name": "second_mode", "values": {"frequency_hz": 1400.0, "share": 0.2}, "modal": True},
    {
        "name": "cross_coupling",
        "values": {"coupling_um_per_v": 0.3, "mode2_um_per_v": 0.1, "mode3_rate_um_per_v": 0.2},
        "aux": "aux_b",
        "modal": True,
    },
]
"""Mode 2 is the one of 900 Hz, whatever other effects stand in the list."""


def test_modes_that_several_inputs_drive_are_simulated_stepped_saved_and_trained(tmp_path: Path) -> None:
    one, u, b = stage(effects=[HUM, *MODAL, LAG], alignment=1), wandering(1, 300), wandering(1, 300, 1)
    assert one.aux_names == ("aux_b",) and one.names.count("second_mode") == 2
    with torch.no_grad():
        y, state = one(u, None, {"aux_b": b})
        first, between = one(u[:, :101], None, {"aux_b": b[:, :101]})
        second, after = one(u[:, 101:], between, {"aux_b": b[:, 101:]})
        alone, _ = one.simulate(u)
    assert torch.equal(torch.cat([first, second], 1), y) and torch.equal(after, state)
    rig = one.stream()
    np.testing.assert_array_equal([rig.step(sample)[0] for sample in u[0].tolist()], alone[0].numpy())
    assert float((y - alone).abs().max()) > 0.01

    one.save(tmp_path / "stage.pt")
    plain = torch.load(tmp_path / "stage.pt", weights_only=True)
    assert json.loads(json.dumps(plain["effects"])) == plain["effects"]
    again = AugmentedStage.load(tmp_path / "stage.pt")
    assert torch.equal(again(u, None, {"aux_b": b})[0], y) and again.to_dict() == one.to_dict()

    one(u, None, {"aux_b": b})[0].square().sum().backward()
    assert all(bool((p.grad != 0).any()) for name, p in one.named_parameters() if "effects.1" in name)
    with pytest.raises(StageError, match="aux_b"):
        one(u)
