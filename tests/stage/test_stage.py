"""The chain: ideal is the identity, batch is stream, parameters are physical, converters at the ends."""

import math
from pathlib import Path

import pytest
import torch
from torch import Tensor

from torchpi.errors import StageError
from torchpi.operators.conformance import OperatorLaws, wandering
from torchpi.stage import Stage

DEFAULT = Path(__file__).parents[2] / "configs/stage/default.yaml"


def small(**changes: dict) -> Stage:
    """A stage with every block in it, of a few numbers, converters and noise included."""
    blocks = {
        "amplifier": {
            "min_voltage_v": 0.0, "max_voltage_v": 10.0, "cutoff_hz": 1500.0, "delay_s": 1.3e-4,
            "converter_bits": 12,
        },
        "actuator": {
            "input_polynomial_v": [1.0, 0.02, -0.001], "thresholds_v": [0.0, 0.5, 1.5],
            "weights_um_per_v": [0.5, 0.2, 0.1], "creep_per_decade": 0.02,
        },
        "mechanics": {"frequency_hz": 620.0, "damping_ratio": 0.02},
        "sensor": {"cutoff_hz": 5000.0, "noise_um": 0.01, "converter_bits": 14},
    }  # fmt: skip
    return Stage.from_dict({"sample_rate_hz": 10_000.0, "seed": 3, **blocks, **changes})


def volts(batch: int = 1, time: int = 600) -> Tensor:
    """Commands over the range and a little beyond it."""
    return 5.0 + 2.7 * wandering(batch, time)


class TestLaws(OperatorLaws):
    """As an operator: windows, bits, causality, gradients (those to delays and hertz are tested below)."""

    def operator(self) -> Stage:
        settings = small().to_dict() | {"sensor": None}
        settings["amplifier"] |= {"min_voltage_v": -5.0, "max_voltage_v": 5.0}  # the input begins at 0
        return _Displacement(**settings).requires_grad_(False)


class _Displacement(Stage):
    """The stage without its ends, so that the laws can step it: volts to displacement."""

    def stream(self):
        return super(Stage, self).stream()


def test_an_ideal_stage_is_what_was_written_one_tick_ago():
    stage, u = Stage(sample_rate_hz=1e4), volts(2)
    y, reading = stage.simulate(u)
    assert torch.equal(y[:, 1:], u[:, :-1]) and bool((y[:, 0] == 0).all())
    assert torch.equal(reading, y)


@pytest.mark.parametrize("block", ["amplifier", "actuator", "mechanics", "sensor"])
def test_an_empty_block_is_the_same_as_none(block):
    u = volts()
    none, empty = (small(**{block: nothing}).simulate(u) for nothing in (None, {}))
    for one, other in zip(none, empty, strict=True):
        assert torch.equal(one, other)
    assert not torch.equal(none[1], small().simulate(u)[1])


def test_reading_at_a_tick_does_not_depend_on_the_command_of_that_tick():
    for stage in (small(), small(amplifier=None)):
        u = volts()
        altered = u.clone()
        altered[:, 300] = 3.0
        for before, after in zip(stage.simulate(u), stage.simulate(altered), strict=True):
            assert torch.equal(before[:, :301], after[:, :301])


@pytest.mark.parametrize("compiled", [False, True])
def test_stream_gives_the_bits_of_simulate(compiled):
    stage, u = small(), volts()
    stream = stage.stream(compiled)
    for seed in (3, 11, 3):
        stream.reset(seed)
        y, reading = stage.simulate(u, seed)
        stepped = torch.tensor([stream.step(command) for command in u[0].tolist()], dtype=torch.float64)
        assert torch.equal(stepped[:, 0], y[0])
        assert torch.equal(stepped[:, 1], reading[0])


def test_windows_with_carried_state_give_the_bits_of_one_pass():
    stage, u = small(), volts(2)
    whole, final = stage(u)
    state, ys = None, []
    for window in u.split(37, 1):
        y, state = stage(window, state)
        ys.append(y)
    assert torch.equal(torch.cat(ys, 1), whole)
    assert torch.equal(state, final)


def test_noise_is_that_of_the_seed_and_of_the_row():
    stage, u = small(sensor={"noise_um": 0.05}), volts().expand(2, -1)
    y, reading = stage.simulate(u)
    noise = (reading - y).detach()
    assert torch.equal(stage.simulate(u)[1], reading)
    assert not torch.equal(noise[0], noise[1])
    assert not torch.equal(stage.simulate(u, seed=4)[1], reading)
    assert noise.std().item() == pytest.approx(0.05, rel=0.1)


def test_forward_has_neither_converters_nor_noise_and_simulate_has_both():
    stage, u = small(), volts()
    y, reading = stage.simulate(u)
    amplifier, sensor = stage.amplifier.converter.quantization, stage.sensor.converter.quantization
    assert torch.equal(y, stage(amplifier(u)[0])[0])
    assert not torch.equal(y, stage(u)[0])
    assert torch.equal(reading, sensor(reading)[0])
    assert (y - stage(u)[0]).abs().max().item() < 10 * amplifier.step_size


def test_commands_beyond_the_limits_do_no_more_than_the_limits():
    stage, u = small(), volts()
    assert stage.min_voltage_v == 0.0 and stage.max_voltage_v == 10.0
    assert torch.equal(stage(20 * u - 100)[0], stage((20 * u - 100).clamp(0, 10))[0])


def test_gradients_to_every_physical_parameter_are_those_of_finite_differences():
    stage, u = small(), volts(2, 200)
    weights = wandering(2, 200, seed=5)

    def loss() -> Tensor:
        return (weights * stage.sensor(stage(u)[0])[0]).sum()

    loss().backward()
    seen = set()
    for name, parameter in stage.named_parameters():
        if not parameter.requires_grad:
            continue
        for i, value in enumerate(parameter.detach().flatten().tolist()):
            step = 1e-6 * abs(value)
            sides = []
            for side in (value + step, value - step):
                parameter.data.view(-1)[i] = side
                sides.append(loss().item())
            parameter.data.view(-1)[i] = value
            found = parameter.grad.flatten()[i].item()
            assert found == pytest.approx((sides[0] - sides[1]) / (2 * step), rel=1e-4), name
        seen.add(name.rsplit(".", 1)[1])
    assert {"cutoff_hz", "delay_s", "w", "per_decade", "frequency_hz", "damping_ratio"} <= seen


def test_a_stage_is_identified_again_by_descent_on_its_physical_parameters():
    truth, model = small(), small(mechanics={"frequency_hz": 600.0, "damping_ratio": 0.03})
    u = volts(1, 2000)
    wanted = truth(u)[0].detach()
    parameters = [model.mechanics.mode.frequency_hz, model.mechanics.mode.damping_ratio]
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


def test_settings_of_a_changed_stage_give_that_stage_again():
    stage, u = small(), volts()
    with torch.no_grad():
        stage.mechanics.mode.frequency_hz.fill_(555.0)
        stage.amplifier.lag.delay_s.fill_(2.2e-4)
        stage.actuator.hysteresis.w.mul_(1.1)
    again = Stage.from_dict(stage.to_dict())
    assert again.to_dict() == stage.to_dict()
    assert torch.equal(again.simulate(u)[1], stage.simulate(u)[1])
    ideal = Stage(sample_rate_hz=1e4).to_dict()
    assert Stage.from_dict(ideal).to_dict() == ideal


def test_one_set_of_physical_parameters_serves_any_sample_rate():
    stage = Stage.from_yaml(DEFAULT)
    t = torch.arange(2000, dtype=torch.float64) / stage.sample_rate_hz
    u = 5 - 4 * torch.cos(2 * math.pi * 20 * t) - torch.cos(2 * math.pi * 80 * t)
    slow, _ = stage(u[None])
    fast, _ = stage.at_sample_rate(80_000.0)(u[None].repeat_interleave(8, 1))
    # What is left is the straight line taken between samples where the amplifier's lag bends it.
    assert (fast[:, ::8] - slow).abs().max().item() < 0.0015 * slow.max().item()
    linear = [
        Stage(sample_rate_hz=rate, amplifier={"cutoff_hz": 2e3, "delay_s": 5e-5}) for rate in (1e4, 8e4)
    ]
    slow, fast = linear[0](u[None])[0], linear[1](u[None].repeat_interleave(8, 1))[0]
    torch.testing.assert_close(fast[:, ::8], slow, rtol=0, atol=1e-11)


def test_a_command_that_is_not_finite_or_not_a_batch_is_refused():
    stage, u = small(), volts(2)
    u[1, 17] = math.nan
    with pytest.raises(StageError, match="u: found nan V in row 1, sample 17, want finite numbers"):
        stage.simulate(u)
    with pytest.raises(StageError, match=r"u: found shape \(600,\), want \(batch, time\)"):
        stage.simulate(volts()[0])
    stream = stage.stream(compiled=False)
    stream.step(1.0)
    with pytest.raises(StageError, match="u: found inf V at sample 1, want a finite number"):
        stream.step(math.inf)


def test_a_delay_longer_than_the_record_is_refused_by_name_and_unit() -> None:
    stage = Stage(sample_rate_hz=1000.0, amplifier={"delay_s": 0.5})
    with pytest.raises(
        StageError, match=r"amplifier\.delay_s: found 0\.5 s, want less than the record, 0\.1 s"
    ):
        stage.simulate(torch.zeros(1, 100))
    stage.simulate(torch.zeros(1, 600))
