"""The direct inverse, eq. 6–8, and its deployed step."""

import math
import warnings

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from torchpi.control.direct_inverse import DirectInverse
from torchpi.control.step import CompensatorStream
from torchpi.errors import ArtifactError, ConfigError
from torchpi.operators import ReferenceFilter
from torchpi.operators.motion import Motion, backward_motion

THRESHOLDS = [0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 1.5, 2.0, 3.0]


def compensator(seed: int = 0, **changes: object) -> DirectInverse:
    arguments = {
        "sample_period_s": 1e-4,
        "thresholds": THRESHOLDS,
        "range_um": 8.0,
        "rate_scale_um_s": 800.0,
        "rate": "neural",
        "lead": 2,
        "creep_time_constants_s": [0.01, 0.3, 5.0],
        "offset": True,
        "output_degree": 3,
        "preview": 3,
        **changes,
    }
    made = DirectInverse(**arguments)
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in made.parameters():
            parameter.add_(0.1 * torch.randn(parameter.shape, dtype=torch.float64, generator=generator))
        made.weights.theta[0, 0] += 1.2
    return made


def trajectory(samples: int = 1500) -> Tensor:
    t = 1e-4 * torch.arange(samples, dtype=torch.float64)
    return 4 - 2.5 * torch.cos(2 * math.pi * 40 * t) + 1.2 * torch.sin(2 * math.pi * 95 * t)


def scripted(stream: CompensatorStream) -> CompensatorStream:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*torch.jit.*deprecated.*")
        return torch.jit.script(stream)


@pytest.mark.parametrize("rate", ["none", "linear", "neural"])
@pytest.mark.parametrize("creep", [[], [0.01, 0.3, 5.0]])
@pytest.mark.parametrize("lead", [0, 1, 2])
@pytest.mark.parametrize("output_degree", [1, 3])
def test_step_block_and_batch_agree_to_the_last_bit(
    rate: str, creep: list[float], lead: int, output_degree: int
) -> None:
    made = compensator(
        rate=rate, lead=lead, creep_time_constants_s=creep, output_degree=output_degree, max_voltage_v=9.0
    )
    yd = trajectory(600)
    batch = made(backward_motion(yd[None], 1e-4))[0]
    assert float(((batch > 0) & (batch < 9)).double().mean()) > 0.2  # not all at a limit
    for stream in (made.stream(), scripted(made.stream())):
        stepped = torch.tensor([stream.step(sample) for sample in yd.tolist()], dtype=torch.float64)
        assert torch.equal(stepped, batch)
        stream.reset()
        # A block, then steps, then a block: they share one state.
        parts = [stream.block(yd[:250])]
        parts += [torch.tensor([stream.step(s) for s in yd[250:300].tolist()], dtype=torch.float64)]
        parts += [stream.block(yd[300:])]
        assert torch.equal(torch.cat(parts), batch)


@settings(max_examples=8)
@given(seed=st.integers(0, 10**6))
def test_bits_agree_for_any_parameters(seed: int) -> None:
    made = compensator(seed)
    yd = trajectory(300)
    assert torch.equal(made.stream().block(yd), made(backward_motion(yd[None], 1e-4))[0].detach())


def test_without_extensions_it_is_eq_8_of_the_paper() -> None:
    made = compensator(
        rate="linear", lead=0, creep_time_constants_s=[], offset=False, preview=0, output_degree=1
    )
    with torch.no_grad():
        made.offset.zero_()
    motion = backward_motion(trajectory()[None], 1e-4)
    s, _ = made.saturation(motion.yd)
    h, _ = made.plays(s)
    k, b = made.weights.k, made.weights.b
    expected = ((k * motion.yd_dot[..., None] + b) * h).sum(-1)
    assert torch.allclose(made.voltage(motion)[0], expected, rtol=1e-10, atol=1e-10)


def test_windows_with_carried_state_give_the_same_bits() -> None:
    made = compensator()
    motion = backward_motion(trajectory()[None], 1e-4)
    whole, final = made.voltage(motion)
    first, state = made.voltage(Motion(*(part[:, :700] for part in motion)))
    second, state = made.voltage(Motion(*(part[:, 700:] for part in motion)), state)
    assert torch.equal(torch.cat([first, second], 1), whole) and torch.equal(state, final)


def test_gradients_reach_every_parameter_and_are_exact() -> None:
    made = compensator(train_thresholds=True)
    with torch.no_grad():
        made.plays.raw_thresholds.abs_().add_(0.01)
    motion = backward_motion(trajectory(12)[None], 1e-2)

    def voltage(*parameters: Tensor) -> Tensor:
        names = [name for name, _ in made.named_parameters()]
        swapped = dict(zip(names, parameters, strict=True))
        with torch.nn.utils.stateless._reparametrize_module(made, swapped):
            return made.voltage(motion)[0]

    values = [p.detach().clone().requires_grad_() for p in made.parameters()]
    assert torch.autograd.gradcheck(voltage, values, eps=1e-7, atol=1e-4)


def test_a_reference_filter_inside_the_stream_gives_the_same_bits_as_outside() -> None:
    made, filter_ = compensator(preview=0), ReferenceFilter(1e-4)
    yr = trajectory(400)
    inside = scripted(made.stream(filter_))
    assert inside.has_reference_filter
    assert torch.equal(inside.block(yr), made(filter_(yr[None]))[0].detach())


def test_an_input_that_is_not_finite_is_replaced_by_the_last_one_and_counted() -> None:
    made = compensator(lead=0)
    for stream in (made.stream(), scripted(made.stream())):
        for sample in (0.1, 0.2):
            stream.step(sample)
        held = [stream.step(sample) for sample in (math.nan, math.inf, -math.inf)]
        assert stream.held_inputs == 3
        assert all(math.isfinite(u) for u in held)
        other = made.stream()
        assert [other.step(s) for s in (0.1, 0.2, 0.2, 0.2, 0.2)][2:] == held


def test_output_stays_within_its_limits() -> None:
    u = compensator(min_voltage_v=1.0, max_voltage_v=2.0)(backward_motion(trajectory()[None], 1e-4))
    assert u.min() == 1.0 and u.max() == 2.0


def test_it_can_be_rebuilt_from_its_hyper_parameters() -> None:
    made = compensator()
    other = DirectInverse(**made.hyper_parameters)
    other.load_state_dict(made.state_dict())
    motion = backward_motion(trajectory()[None], 1e-4)
    assert torch.equal(other(motion), made(motion))


def test_a_compensator_that_diverged_is_not_deployed() -> None:
    made = compensator()
    with torch.no_grad():
        made.weights.theta[0, 0] = math.nan
    with pytest.raises(ArtifactError, match=r"weights\.theta: found .*nan"):
        made.stream()


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"sample_period_s": 0.0}, "sample_period_s"),
        ({"degree": 0}, "degree"),
        ({"preview": -1}, "preview"),
        ({"lead": 3}, "lead"),
        ({"creep_time_constants_s": [-1.0]}, "creep_time_constants_s"),
        ({"min_voltage_v": 10.0}, "min_voltage_v"),
        ({"min_voltage_v": -math.inf}, "min_voltage_v"),
    ],
)
def test_invalid_arguments_are_named_in_the_error(changes: dict, named: str) -> None:
    with pytest.raises(ConfigError, match=f"{named}: found"):
        compensator(**changes)
