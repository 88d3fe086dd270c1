"""Compensators and stages run on a GPU with the same results as on a CPU."""

import numpy as np
import pytest
import torch

from torchpi.control.direct_inverse import DirectInverse
from torchpi.operators.motion import backward_motion
from torchpi.operators.rate_weights import RateHead
from torchpi.stage.stage import Stage

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU that torch can use")


@pytest.mark.parametrize("rate", ["none", "linear", "neural"])
def test_a_compensator_has_the_same_voltages_and_gradients_on_gpu_and_cpu(rate: RateHead) -> None:
    t = torch.arange(3000, dtype=torch.float64) * 1e-4
    yd = (4 - 4 * torch.cos(2 * torch.pi * 20 * t) * (1 + 0.3 * torch.sin(2 * torch.pi * 3 * t)))[None]
    torch.manual_seed(0)
    compensator = DirectInverse(1e-4, [0.0, 0.2, 0.7, 1.5], rate=rate, range_um=12.0, rate_scale_um_s=2000.0)
    with torch.no_grad():
        for parameter in compensator.parameters():
            parameter += 0.1 * torch.rand_like(parameter)
    found = []
    for device in ("cpu", "cuda"):
        compensator = compensator.to(device)
        compensator.zero_grad()
        u, _ = compensator.voltage(backward_motion(yd.to(device), 1e-4))
        u.square().mean().backward()
        gradients = {
            name: p.grad.cpu().clone()
            for name, p in compensator.named_parameters()
            if p.grad is not None and p.grad.any()
        }
        found.append((u.detach().cpu(), gradients))
    (u, gradients), (on_gpu, gradients_on_gpu) = found
    torch.testing.assert_close(on_gpu, u, rtol=1e-11, atol=1e-11)
    assert gradients and gradients.keys() == gradients_on_gpu.keys()
    for name, gradient in gradients.items():
        torch.testing.assert_close(gradients_on_gpu[name], gradient, rtol=1e-8, atol=1e-10)


def test_a_stage_has_the_same_displacement_on_gpu_and_cpu() -> None:
    u = torch.from_numpy(5 - 5 * np.cos(2 * np.pi * 30 * np.arange(2000) * 1e-4))[None]
    stage = Stage.load("default")
    expected, _ = stage(u)
    y, _ = stage.to("cuda")(u.cuda())
    torch.testing.assert_close(y.cpu(), expected, rtol=1e-11, atol=1e-11)
