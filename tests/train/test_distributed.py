"""Under DDP each process takes a part of the batch, and all obtain the gradients of the whole batch."""

from pathlib import Path

import torch
import torch.multiprocessing
from torch import Tensor
from torch.distributed import destroy_process_group, init_process_group
from torch.nn.parallel import DistributedDataParallel

from torchpi.control.direct_inverse import DirectInverse
from torchpi.operators.conformance import wandering
from torchpi.operators.motion import backward_motion

PROCESSES = 2
PERIOD_S = 1e-3


def test_two_processes_obtain_the_gradients_of_the_whole_batch(tmp_path: Path) -> None:
    torch.multiprocessing.spawn(one_process, (str(tmp_path),), PROCESSES)
    whole = gradients(compensator(), batch())
    for rank in range(PROCESSES):
        found = torch.load(tmp_path / f"{rank}.pt", weights_only=True)
        assert found.keys() == whole.keys()
        for name, gradient in found.items():
            torch.testing.assert_close(gradient, whole[name], rtol=1e-12, atol=1e-14)


def one_process(rank: int, folder: str) -> None:
    torch.set_num_threads(1)
    init_process_group("gloo", f"file://{folder}/meet", rank=rank, world_size=PROCESSES)
    model = DistributedDataParallel(Voltage(compensator()), find_unused_parameters=True)
    torch.save(gradients(model.module.inverse, batch()[rank::PROCESSES], model), f"{folder}/{rank}.pt")
    destroy_process_group()


class Voltage(torch.nn.Module):
    """Eq. 8 for a batch of trajectories, as a module that DDP can call."""

    def __init__(self, inverse: DirectInverse) -> None:
        super().__init__()
        self.inverse = inverse

    def forward(self, yd: Tensor) -> Tensor:
        return self.inverse.voltage(backward_motion(yd, PERIOD_S))[0]


def compensator() -> DirectInverse:
    model = DirectInverse(PERIOD_S, [0.0, 0.3, 0.8], range_um=2.0, rate_scale_um_s=100.0)
    with torch.no_grad():
        model.weights.theta.copy_(torch.linspace(-0.5, 1.0, model.weights.theta.numel()).reshape(3, -1))
    return model


def batch() -> Tensor:
    return wandering(4, 300)


def gradients(inverse: DirectInverse, yd: Tensor, model: torch.nn.Module | None = None) -> dict[str, Tensor]:
    (model or Voltage(inverse))(yd).square().mean().backward()
    return {name: part.grad for name, part in inverse.named_parameters() if part.grad is not None}
