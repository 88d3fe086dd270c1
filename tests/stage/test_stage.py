"""The stage: a chain of effects around a hysteresis; equality of stream and batch; gradients."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from torchpi.errors import ConfigError, StageError
from torchpi.loop import run_loop
from torchpi.loop.result import COMPENSATED
from torchpi.operators import PrandtlIshlinskii
from torchpi.operators.conformance import OperatorLaws, wandering
from torchpi.stage import Stage
from torchpi.stage.effects import EFFECTS
from torchpi.stage.effects.actuator.input_nonlinearity import InputNonlinearity
from torchpi.stage.effects.amplifier.amplifier_lag import AmplifierLag
from torchpi.stage.effects.effect import Effect
from torchpi.stage.effects.mechanics.resonance import Resonance
from torchpi.stage.effects.sensor.hum import Hum
from torchpi.stage.hysteresis import Hysteresis

DEFAULT = Path(__file__).parents[2] / "configs/stage/default.yaml"
RATE_HZ = 1e4
HYSTERESIS = {"thresholds_v": [0.0, 0.2, 0.7], "weights": [0.6, 0.2, 0.1, 0.0]}
RESONANCE = {"name": "resonance", "values": {"frequency_hz": 400.0, "damping_ratio": 0.02}}
LAG = {"name": "amplifier_lag", "values": {"cutoff_hz": 900.0}}
DELAY = {"name": "delay", "values": {"delay_s": 1.3e-4, "after_lag": 1.0}}
CURVATURE = {"name": "input_nonlinearity", "values": {"c2_per_v": 0.02}}
CREEP = {"name": "creep", "values": {"per_decade": 0.02, "from_s": 0.01, "to_s": 10.0}}
HUM = {"name": "hum", "values": {"frequency_hz": 50.0, "cos_um": 0.01, "sin_um": 0.02}}
RATE = {"name": "rate_dependent_hysteresis", "values": {"weight_s_per_v": 1e-5}}
COUPLING = {"name": "cross_coupling", "values": {"coupling_um_per_v": 0.1}, "aux": "aux_v"}
SENSOR_LAG = {"name": "sensor_lag", "values": {"cutoff_hz": 5000.0}}


def small(**changes: object) -> Stage:
    """Return a small stage with every section of a file, converters and noise included."""
    sections = {
        "amplifier": {
            "min_voltage_v": 0.0,
            "max_voltage_v": 10.0,
            "cutoff_hz": 1500.0,
            "delay_s": 1.3e-4,
            "converter_bits": 12,
        },
        "actuator": {
            "input_polynomial_v": [1.0, 0.02, -0.001],
            "thresholds_v": [0.0, 0.5, 1.5],
            "weights_um_per_v": [0.5, 0.2, 0.1],
            "creep_per_decade": 0.02,
        },
        "mechanics": {"frequency_hz": 620.0, "damping_ratio": 0.02},
        "sensor": {"cutoff_hz": 5000.0, "noise_um": 0.01, "converter_bits": 14},
    }
    return Stage.from_dict({"sample_rate_hz": RATE_HZ, "seed": 3, **sections, **changes})


def chain(**changes: object) -> Stage:
    """Return a stage of effects as a diagnosis builds it."""
    settings = {"effects": [HUM, RESONANCE, RATE, LAG], "alignment": 1, "noise_um": 0.003}
    settings |= {"min_voltage_v": 0.0, "max_voltage_v": 10.0, **changes}
    return Stage(RATE_HZ, HYSTERESIS, **settings)


def operator(stage: Stage, kind: type[Effect]) -> Effect:
    """Return the stage's only effect of this kind."""
    (found,) = (one for one in stage.modules() if isinstance(one, kind))
    return found


def volts(batch: int = 1, time: int = 600) -> Tensor:
    """Return commands over the range and slightly beyond it."""
    return 5.0 + 2.7 * wandering(batch, time)


class TestLaws(OperatorLaws):
    """The stage as an operator: windows, bits, causality, gradients (to delays and hertz: see below)."""

    def operator(self) -> Stage:
        effects = [LAG, DELAY, CURVATURE, CREEP, RESONANCE, RATE, HUM]
        limits = {"min_voltage_v": -5.0, "max_voltage_v": 5.0, "saturates": True}
        return _Displacement(RATE_HZ, HYSTERESIS, effects, alignment=1, **limits).requires_grad_(False)


class _Displacement(Stage):
    """The stage from volts to displacement, without sensor and noise, so that the laws can step it."""

    def stream(self):
        return super().stream(compiled=False).rig.to_displacement


def test_effects_act_in_the_order_of_the_chain_whatever_order_they_are_given_in() -> None:
    u = wandering(2, 400)
    late = torch.cat([torch.zeros(2, 1), u[:, :-1]], 1)
    one = chain(effects=[HUM, RESONANCE, CURVATURE, RATE, LAG])
    with torch.no_grad():
        v, _ = AmplifierLag(1e-4, cutoff_hz=900.0)(late)
        v, _ = InputNonlinearity(1e-4, c2_per_v=0.02)(v)
        y, _ = Hysteresis(1e-4, **HYSTERESIS, shape={"weight_s_per_v": 1e-5})(v)
        y, _ = Resonance(1e-4, frequency_hz=400.0, damping_ratio=0.02)(y)
        y, _ = Hum(1e-4, **HUM["values"])(y)
        assert torch.equal(one(u)[0], y)
    order = ("amplifier_lag", "input_nonlinearity", "rate_dependent_hysteresis", "resonance", "hum")
    assert one.names == order == tuple(effect.kind.name for effect in one.effects)


def test_with_every_effect_at_its_identity_it_equals_the_hysteresis() -> None:
    every = [{"name": e.name, "values": {}, "aux": "aux_v" if e.takes_aux else ""} for e in EFFECTS]
    u = wandering(1, 300)
    with torch.no_grad():
        y, _ = chain(effects=every, alignment=0)(u, None, {"aux_v": u})
        assert torch.equal(y, Hysteresis(1e-4, **HYSTERESIS)(u)[0])


def test_an_ideal_stage_returns_the_command_of_the_previous_tick() -> None:
    stage, u = Stage.from_dict({"sample_rate_hz": RATE_HZ}), volts(2)
    y, reading = stage.simulate(u)
    assert torch.equal(y[:, 1:], u[:, :-1]) and bool((y[:, 0] == 0).all())
    assert torch.equal(reading, y)


@pytest.mark.parametrize("section", ["amplifier", "actuator", "mechanics", "sensor"])
def test_an_empty_section_is_the_same_as_none(section: str) -> None:
    u = volts()
    none, empty = (small(**{section: nothing}).simulate(u) for nothing in (None, {}))
    for one, other in zip(none, empty, strict=True):
        assert torch.equal(one, other)
    assert not torch.equal(none[1], small().simulate(u)[1])


def test_sections_of_a_file_become_named_effects() -> None:
    names = ("amplifier_lag", "delay", "input_nonlinearity", "creep", "resonance")
    assert small().names == names
    assert [one.kind.name for one in small().sensor_effects] == ["sensor_lag"]
    rigid = small(mechanics=None, amplifier={"max_voltage_v": 10.0}, sensor={"noise_um": 0.1})
    assert rigid.names == ("input_nonlinearity", "creep") and rigid.sensor_effects == ()


def test_a_gain_in_the_input_polynomial_scales_the_input_of_the_plays() -> None:
    gain, u = 1.25, volts()
    actuator = {"thresholds_v": [0.0, 0.5], "weights_um_per_v": [0.5, 0.2]}
    with torch.no_grad():
        v, _ = InputNonlinearity(1e-4, c2_per_v=0.02)(u)
        wanted, _ = PrandtlIshlinskii([0.0, 0.5], [0.5, 0.2])(gain * v)
    rigid = {"amplifier": None, "mechanics": None}
    one = small(actuator={**actuator, "input_polynomial_v": [gain, 0.02 * gain]}, **rigid)
    torch.testing.assert_close(one(u)[0][:, 1:], wanted[:, :-1], rtol=0, atol=1e-13)


def test_reading_at_a_tick_does_not_depend_on_the_command_of_that_tick() -> None:
    for stage in (small(), small(amplifier=None)):
        u = volts()
        altered = u.clone()
        altered[:, 300] = 3.0
        for before, after in zip(stage.simulate(u), stage.simulate(altered), strict=True):
            assert torch.equal(before[:, :301], after[:, :301])


EVERY_KIND = [LAG, DELAY, RATE, COUPLING, CREEP, RESONANCE, HUM]


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("make", [small, lambda: chain(effects=EVERY_KIND, sensor=[SENSOR_LAG])])
def test_stream_gives_the_same_bits_as_simulate(make, compiled: bool) -> None:
    stage, u = make(), volts()
    stream = stage.stream(compiled)
    for seed in (3, 11, 3):
        stream.reset(seed)
        y, reading = stage.simulate(u, seed)
        stepped = torch.tensor([stream.step(command) for command in u[0].tolist()], dtype=torch.float64)
        assert torch.equal(stepped[:, 0], y[0])
        assert torch.equal(stepped[:, 1], reading[0])


@pytest.mark.parametrize("alignment", [0, 1])
def test_windows_with_carried_state_give_the_same_bits_as_one_pass(alignment: int) -> None:
    one = chain(effects=[LAG, DELAY, COUPLING, HUM], alignment=alignment, zero_um=0.3)
    u, aux = wandering(2, 300), wandering(2, 300, 1)
    with torch.no_grad():
        whole, final = one(u, None, {"aux_v": aux})
        parts, state = [], None
        for part in (slice(0, 101), slice(101, 102), slice(102, 300)):
            y, state = one(u[:, part], state, {"aux_v": aux[:, part]})
            parts.append(y)
    assert torch.equal(torch.cat(parts, 1), whole) and torch.equal(state, final)


def test_noise_is_reproduced_by_the_seed_and_differs_between_rows() -> None:
    stage, u = small(sensor={"noise_um": 0.05}), volts().expand(2, -1)
    y, reading = stage.simulate(u)
    noise = (reading - y).detach()
    assert torch.equal(stage.simulate(u)[1], reading)
    assert not torch.equal(noise[0], noise[1])
    assert not torch.equal(stage.simulate(u, seed=4)[1], reading)
    assert noise.std().item() == pytest.approx(0.05, rel=0.1)


def test_forward_has_neither_converters_nor_noise_and_simulate_has_both() -> None:
    stage, u = small(), volts()
    y, reading = stage.simulate(u)
    command, sensor = stage.command_converter, stage.reading_converter
    assert command is not None and sensor is not None
    assert torch.equal(y, stage(command(u)[0])[0])
    assert not torch.equal(y, stage(u)[0])
    assert torch.equal(reading, sensor(reading)[0])
    assert (y - stage(u)[0]).abs().max().item() < 10 * command.step_size


def test_commands_beyond_the_limits_are_clipped_only_if_the_amplifier_saturates() -> None:
    u = volts()
    for stage in (small(), chain(), chain(saturates=True)):
        assert stage.min_voltage_v == 0.0 and stage.max_voltage_v == 10.0
        clipped = torch.equal(stage(20 * u - 100)[0], stage((20 * u - 100).clamp(0, 10))[0])
        assert clipped == stage.saturates
    assert not chain().saturates  # the range of its recordings is not a limit of its amplifier


STAYING = (
    "before.1.damping_ratio",
    "hysteresis.relaxation_s",
    "after.1.replaced_frequency_hz",
    "after.1.replaced_damping_ratio",
    "sensor.sensor_lag_0.damping_ratio",
)
"""Parameters without a gradient: lags have one pole, plays do not relax, a mode replaces no other."""


def test_gradients_to_every_physical_parameter_match_finite_differences() -> None:
    stage, u = small(), volts(2, 200)
    stage.hysteresis.asymmetry_per_v.requires_grad_(False)  # a kink at 0
    weights = wandering(2, 200, seed=5)

    def loss() -> Tensor:
        return (weights * stage.sensor(stage(u)[0])[0]).sum()

    loss().backward()
    assert {name for name, parameter in stage.named_parameters() if parameter.grad is None} >= {*STAYING}
    seen = set()
    for name, parameter in stage.named_parameters():
        if not parameter.requires_grad or name in STAYING:
            continue
        for i, value in enumerate(parameter.detach().flatten().tolist()):
            step = 1e-6 * abs(value) or 1e-7
            sides = []
            for side in (value + step, value - step):
                parameter.data.view(-1)[i] = side
                sides.append(loss().item())
            parameter.data.view(-1)[i] = value
            found = parameter.grad.flatten()[i].item()
            assert found == pytest.approx((sides[0] - sides[1]) / (2 * step), rel=2e-4, abs=1e-4), name
        seen.add(name.rsplit(".", 1)[-1])
    assert {"cutoff_hz", "delay_s", "weights", "per_decade", "frequency_hz", "damping_ratio"} <= seen
    assert "from_s" in seen and "to_s" not in seen


def test_gradients_through_rate_dependence_and_another_axis_are_exact() -> None:
    one, u, aux = chain(effects=[LAG, RATE, COUPLING, RESONANCE]), 1 + wandering(1, 30), wandering(1, 30, 1)
    one.hysteresis.asymmetry_per_v.requires_grad_(False)
    names, parameters = zip(*one.named_parameters(), strict=True)

    def output(u: Tensor, *values: Tensor) -> Tensor:
        inputs = (u, None, {"aux_v": aux})
        return torch.func.functional_call(one, dict(zip(names, values, strict=True)), inputs)[0]

    inputs = [u.requires_grad_(), *(p.detach().clone().requires_grad_(p.requires_grad) for p in parameters)]
    assert torch.autograd.gradcheck(output, inputs, eps=1e-6, atol=1e-5)


def test_descent_on_its_physical_parameters_fits_a_stage_to_another() -> None:
    truth, model = small(), small(mechanics={"frequency_hz": 600.0, "damping_ratio": 0.03})
    u = volts(1, 2000)
    wanted = truth(u)[0].detach()
    mode = operator(model, Resonance)
    parameters = [mode.frequency_hz, mode.damping_ratio]
    optimizer = torch.optim.LBFGS(
        parameters, max_iter=60, line_search_fn="strong_wolfe", tolerance_change=1e-15
    )

    def closure() -> Tensor:
        optimizer.zero_grad()
        loss = 1e4 * ((model(u)[0] - wanted) ** 2).mean()
        loss.backward()
        return loss

    first = closure().item()
    for _ in range(10):
        optimizer.step(closure)
    assert closure().item() < 1e-4 * first


def test_one_set_of_physical_parameters_is_valid_at_any_sample_rate() -> None:
    stage = Stage.from_yaml(DEFAULT)
    t = torch.arange(2000, dtype=torch.float64) / stage.sample_rate_hz
    u = 5 - 4 * torch.cos(2 * math.pi * 20 * t) - torch.cos(2 * math.pi * 80 * t)
    slow, _ = stage(u[None])
    fast, _ = stage.at_sample_rate(80_000.0)(u[None].repeat_interleave(8, 1))
    # The rest is due to straight lines between samples where the amplifier's lag makes a curve.
    assert (fast[:, ::8] - slow).abs().max().item() < 0.0015 * slow.max().item()
    amplifier = {"cutoff_hz": 2e3, "delay_s": 5e-5}
    linear = [Stage.from_dict({"sample_rate_hz": rate, "amplifier": amplifier}) for rate in (1e4, 8e4)]
    slow, fast = linear[0](u[None])[0], linear[1](u[None].repeat_interleave(8, 1))[0]
    torch.testing.assert_close(fast[:, ::8], slow, rtol=0, atol=1e-11)


def test_the_plain_stage_is_its_hysteresis_alone() -> None:
    u = wandering(1, 200)
    with torch.no_grad():
        plain = chain(alignment=0, sensor=[SENSOR_LAG]).plain()
        assert torch.equal(plain(u)[0], Hysteresis(1e-4, **HYSTERESIS)(u)[0])
    assert plain.names == () and plain.sensor_effects == ()


def test_a_command_that_is_not_finite_or_not_a_batch_is_refused() -> None:
    stage, u = small(), volts(2)
    u[1, 17] = math.nan
    with pytest.raises(StageError, match="u: found nan V in row 1, sample 17, expected finite numbers"):
        stage.simulate(u)
    with pytest.raises(StageError, match=r"u: found shape \(600,\), expected \(batch, time\)"):
        stage.simulate(volts()[0])
    stream = stage.stream(compiled=False)
    stream.step(1.0)
    with pytest.raises(StageError, match="u: found inf V at sample 1, expected a finite number"):
        stream.step(math.inf)


def test_a_delay_longer_than_the_record_is_refused_with_name_and_unit() -> None:
    stage = Stage.from_dict({"sample_rate_hz": 1000.0, "amplifier": {"delay_s": 0.5}})
    with pytest.raises(StageError, match=r"delay_s: found 0\.5 s, expected less than the record, 0\.1 s"):
        stage.simulate(torch.zeros(1, 100))
    stage.simulate(torch.zeros(1, 600))


def test_invalid_or_unknown_settings_are_named_in_the_error() -> None:
    with pytest.raises(StageError, match="cross_coupling: found no signal 'aux_v'"):
        chain(effects=[COUPLING])(wandering(1, 10))
    with pytest.raises(StageError, match="effects: found 'gremlins', expected one of voltage_saturation"):
        chain(effects=[{"name": "gremlins", "values": {}}])
    with pytest.raises(StageError, match="cross_coupling: found the auxiliary signal ''"):
        chain(effects=[{"name": "cross_coupling", "values": {}}])
    with pytest.raises(StageError, match="resonance: found the unknown parameter 'hz', expected freq"):
        chain(effects=[{"name": "resonance", "values": {"hz": 3.0}}])
    with pytest.raises(StageError, match="sensor: found 'creep', expected effects of the sensor"):
        chain(sensor=[CREEP])
    with pytest.raises(StageError, match="alignment: found 2"):
        chain(alignment=2)
    with pytest.raises(StageError, match="cutoff_hz"):
        chain(effects=[{"name": "amplifier_lag", "values": {"cutoff_hz": -1.0}}])
    with pytest.raises(StageError, match="weight_s_per_v"):
        chain(effects=[{"name": "rate_dependent_hysteresis", "values": {"weight_s_per_v": 9.0}}])
    with pytest.raises(StageError, match="effects: found an entry without a name"):
        chain(effects=[{"values": {}}])
    with pytest.raises(ConfigError, match=r"stage: .*could not convert string to float: 'fast'"):
        Stage.from_dict({**chain().to_dict(), "effects": [{"name": "hum", "values": {"cos_um": "fast"}}]})
    with pytest.raises(ConfigError, match="stage: unknown key effect; the nearest one is effects"):
        Stage.from_dict({**chain().to_dict(), "effect": []})


class Straight:
    """u = y_d / gain."""

    sample_period_s, preview = 1 / RATE_HZ, 0

    def reset(self) -> None: ...

    def step(self, yd: float) -> float:
        return yd / 0.9


def test_a_control_loop_runs_against_the_stage() -> None:
    t = np.arange(2000) / RATE_HZ
    wanted = 4 - 3 * np.cos(2 * np.pi * 10 * t)
    result = run_loop(Straight(), chain(), wanted, fs_hz=RATE_HZ, name="sine")
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
"""Mode 2 is the one at 900 Hz, whatever other effects the list contains."""


def test_modes_driven_by_several_inputs_are_simulated_stepped_saved_and_trained(tmp_path: Path) -> None:
    one, u, b = chain(effects=[HUM, *MODAL, LAG], alignment=1), wandering(1, 300), wandering(1, 300, 1)
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
    again = Stage.load(tmp_path / "stage.pt")
    assert torch.equal(again(u, None, {"aux_b": b})[0], y) and again.to_dict() == one.to_dict()

    one(u, None, {"aux_b": b})[0].square().sum().backward()
    assert all(bool((p.grad != 0).any()) for name, p in one.named_parameters() if "after.0" in name)
    with pytest.raises(StageError, match="aux_b"):
        one(u)


def test_an_array_gives_arrays_and_a_tensor_the_same_numbers_with_gradients() -> None:
    stage, u = Stage.from_yaml("default"), np.linspace(0.0, 5.0, 50)[None]
    y, reading = stage.simulate(u)
    assert isinstance(y, np.ndarray) and isinstance(reading, np.ndarray)
    of_tensor, read = stage.simulate(torch.from_numpy(u))
    assert of_tensor.requires_grad
    assert np.array_equal(of_tensor.detach().numpy(), y) and np.array_equal(read.detach().numpy(), reading)
    assert np.array_equal(stage.simulate(u.astype(np.float32))[0].shape, y.shape)


@pytest.mark.parametrize(
    ("u", "found"),
    [
        ([[0.0, 1.0]], "list, expected a tensor or a NumPy array"),
        (np.zeros(5), r"shape \(5,\), expected \(batch, time\)"),
        (np.array([["a", "b"]]), "an array of <U1, expected numbers"),
    ],
)
def test_an_input_that_is_not_a_batch_of_voltages_is_refused(u: Any, found: str) -> None:
    with pytest.raises(StageError, match=f"u: found {found}"):
        Stage.from_yaml("default").simulate(u)
