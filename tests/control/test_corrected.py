"""A corrected inverse: its step equals its batch, and each pass reduces the error of the inverse."""

import itertools
import math
import warnings

import pytest
import torch

from torchpi.control.corrected import CorrectedInverse, delayed
from torchpi.control.direct_inverse import DirectInverse
from torchpi.errors import ConfigError
from torchpi.export import export_files, load_torchscript
from torchpi.identification.corrections import fit_corrections
from torchpi.operators import ReferenceFilter
from torchpi.operators.motion import backward_motion

PERIOD = 1e-3


def operator(weights: list[list[float]], preview: int = 0) -> DirectInverse:
    made = DirectInverse(
        PERIOD,
        [0.0, 0.3, 0.8],
        degree=1,
        rate_scale_um_s=100.0,
        preview=preview,
        min_voltage_v=-100.0,
        max_voltage_v=100.0,
    )
    with torch.no_grad():
        made.weights.theta.copy_(torch.tensor(weights, dtype=torch.float64))
    return made


# A stage that leads its voltage through a rate term, and an inverse that lacks this term.
MODEL = [[0.8, -0.03], [0.1, 0.0], [0.1, 0.0]]
START = [[1.2, 0.0], [-0.15, 0.0], [-0.1, 0.0]]


def voltage(seed: int) -> torch.Tensor:
    t = PERIOD * torch.arange(1500, dtype=torch.float64)
    phases = torch.rand(3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) * 2 * math.pi
    wave = sum(torch.sin(2 * math.pi * f * t + p) for f, p in zip((3, 7, 13), phases, strict=True))
    return ((4 + wave) * (1 - torch.exp(-t / 0.02)))[None]


def corrected(passes: int, preview: int = 2) -> CorrectedInverse:
    made = fit_corrections(
        operator(START, preview), operator(MODEL), [voltage(0), voltage(1)], passes, before=2, ahead=3
    )
    assert made.preview == preview + 3 * passes
    return made


@pytest.mark.parametrize("passes", [0, 1, 3])
@pytest.mark.parametrize("filtered", [False, True])
def test_step_block_and_batch_agree_to_the_last_bit(passes: int, filtered: bool) -> None:
    made = corrected(passes)
    reference = ReferenceFilter(PERIOD) if filtered else None
    yr = 1 + voltage(5)[0]
    yd = reference(yr[None]).yd[0] if reference else yr
    batch = made(backward_motion(yd[None], PERIOD))[0].detach()
    stream = made.stream(reference)
    assert torch.equal(
        torch.tensor([stream.step(sample) for sample in yr.tolist()], dtype=torch.float64), batch
    )
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*torch.jit.*deprecated.*")
        scripted = torch.jit.script(made.stream(reference))
    for _ in range(2):
        scripted.reset()
        assert torch.equal(scripted.block(yr), batch)


def test_the_exported_file_gives_the_same_numbers(tmp_path) -> None:
    made = corrected(2)
    export_files(made, tmp_path / "c", ["torchscript"])
    loaded = load_torchscript(tmp_path / "c.pt")
    yd = voltage(5)[0]
    assert loaded.preview == made.preview
    assert torch.equal(loaded.block(yd), made(backward_motion(yd[None], PERIOD))[0].detach())


def test_without_passes_it_equals_the_initial_inverse() -> None:
    made = corrected(0)
    motion = backward_motion(voltage(5), PERIOD)
    assert torch.equal(made(motion), made.inverse(motion).clamp(0, 10))


def test_every_pass_reduces_the_error_on_a_motion_that_was_not_fitted() -> None:
    left = []
    for passes in range(4):
        made = corrected(passes)
        u = voltage(9)
        with torch.no_grad():
            answer = made.model.voltage(backward_motion(u, PERIOD))[0]
            found = made(backward_motion(answer, PERIOD))
        left.append(float((found - delayed(u, made.preview))[:, 300:].square().mean().sqrt()))
    assert all(later < 0.7 * earlier for earlier, later in itertools.pairwise(left))


def test_invalid_parts_are_named_in_the_error() -> None:
    start, model = operator(START), operator(MODEL)
    with pytest.raises(ConfigError, match="filters: found shape"):
        CorrectedInverse(start, model, torch.zeros(2, 3), 3, 0.0, 10.0)
    with pytest.raises(ConfigError, match="min_voltage_v"):
        CorrectedInverse(start, model, torch.zeros(2, 5), 3, 10.0, 0.0)
    slower = DirectInverse(2 * PERIOD, [0.0])
    with pytest.raises(ConfigError, match="sample period"):
        CorrectedInverse(start, slower, torch.zeros(2, 5), 3, 0.0, 10.0)
