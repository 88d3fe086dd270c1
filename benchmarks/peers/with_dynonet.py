"""dynonet: linear dynamics, a static network, linear dynamics again, and a linear path in parallel."""

import time

import torch
from task import Fitted, Peer, Signal, Task
from torch import Tensor, nn

from torchpi.identification import InversePair

CHANNELS, STEPS, LEARNING_RATE = 8, 2000, 5e-3


def fit(task: Task) -> Fitted:
    torch.manual_seed(0)
    middle = task.high_v / 2
    x = _inputs(task, task.train)
    wanted = (task.train.u.float() / middle - 1)[..., None]
    start = time.process_time()
    network = _network()
    optimizer = torch.optim.Adam(network.parameters(), LEARNING_RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, STEPS)
    for _ in range(STEPS):
        optimizer.zero_grad()
        (network(x) - wanted).square().mean().backward()
        optimizer.step()
        schedule.step()
    fit_s = time.process_time() - start

    def voltage(pair: InversePair) -> Signal:
        with torch.no_grad():
            u: Signal = middle * (1 + network(_inputs(task, pair))[0, :, 0].double().numpy())
        return u

    return Fitted(voltage, fit_s)


def _inputs(task: Task, pair: InversePair) -> Tensor:
    """Return the displacement scaled to -1 to 1, and the other inputs scaled to a similar size."""
    sizes, middle = torch.tensor([2.0, 3.0, 3.0]), torch.tensor([1.0, 0.0, 0.0])
    return (torch.from_numpy(task.inputs(pair)).float() * sizes - middle)[None]


def _network() -> nn.Module:
    from dynonet.lti import MimoLinearDynamicalOperator
    from dynonet.static import MimoStaticNonLinearity

    class Network(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.before = MimoLinearDynamicalOperator(3, CHANNELS, n_b=2, n_a=1)
            self.static = MimoStaticNonLinearity(CHANNELS + 3, CHANNELS, n_hidden=20)
            self.after = MimoLinearDynamicalOperator(CHANNELS, 1, n_b=2, n_a=1)
            self.straight = nn.Linear(3, 1)

        def forward(self, x: Tensor) -> Tensor:
            inside = self.static(torch.cat([self.before(x), x], -1))
            y: Tensor = self.after(inside) + self.straight(x)
            return y

    return Network()


PEER = Peer(
    "dynonet",
    "dynonet",
    f"Linear blocks of first order (3 → {CHANNELS} and {CHANNELS} → 1 channels) around a network of 20 "
    f"hidden units, a linear path beside them; {STEPS:,} steps of Adam from {LEARNING_RATE:g}, cosine "
    "schedule, float32.",
    "linear dynamics with static nonlinearities; it has no hysteresis, and no way to run sample by sample.",
    fit,
)
