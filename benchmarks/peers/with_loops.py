"""Straightforward PyTorch: a loop over samples and backpropagation through time.

One evaluation (forward and backward over the record) is timed and multiplied by the number of evaluations of
the fit. To save time the fit itself runs on torchpi's kernels, which give the same numbers.
"""

import time
import warnings
from collections.abc import Callable
from typing import Any

import torch
from task import Fitted, Peer, Signal, Task
from torch import Tensor, nn
from with_torchpi import inverse

from torchpi import DirectInverse, Motion
from torchpi.identification import InversePair, fit_two_stage

Loop = Callable[[Tensor, Tensor, Tensor, Tensor, Tensor], Tensor]


def loop(x: Tensor, c: Tensor, r: Tensor, gains: Tensor, decay: Tensor) -> Tensor:
    """Play states after creep and polynomial, sample by sample. Shape: (time, plays)."""
    xi, h = torch.zeros_like(gains), torch.zeros_like(r)
    states: list[Tensor] = []
    for t in range(x.shape[0]):
        s = x[t] + torch.sum(gains * xi)
        xi = decay * xi + (1 - decay) * x[t]
        total = torch.zeros_like(s)
        for i in range(c.shape[0] - 1, -1, -1):
            total = (total + c[i]) * s
        h = torch.maximum(total - r, torch.minimum(total + r, h))
        states.append(h)
    return torch.stack(states)


def fit_eager(task: Task) -> Fitted:
    return _fit(task, loop, lambda step: step)


def fit_scripted(task: Task) -> Fitted:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*torch.jit.*deprecated.*")
        scripted = torch.jit.script(loop)
        return _fit(task, scripted, _frozen)


def _fit(task: Task, states: Loop, deploy: Callable[[nn.Module], Any]) -> Fitted:
    compensator = inverse(task)
    fit_two_stage(compensator, [task.train])
    evaluation_s = _evaluation_s(compensator, task.train, states)
    evaluations = _search(compensator, task.train)
    step = deploy(_Step(compensator).eval())

    def voltage(pair: InversePair) -> Signal:
        u: Signal = compensator.voltage(pair.motion)[0][0].detach().numpy()
        return u

    return Fitted(voltage, evaluations * evaluation_s, step=_without_gradients(step))


def _evaluation_s(compensator: DirectInverse, pair: InversePair, states: Loop, repeats: int = 3) -> float:
    times = []
    for _ in range(repeats):
        compensator.zero_grad()
        start = time.process_time()
        _loss(_looped(compensator, pair.motion, states), pair).backward()
        times.append(time.process_time() - start)
    gradient = torch.cat([p.grad.flatten() for p in compensator.parameters() if p.grad is not None])
    compensator.zero_grad()
    _loss(compensator.voltage(pair.motion)[0], pair).backward()
    expected = torch.cat([p.grad.flatten() for p in compensator.parameters() if p.grad is not None])
    torch.testing.assert_close(gradient, expected)
    return min(times)  # TorchScript compiles in the first two


def _looped(compensator: DirectInverse, motion: Motion, states: Loop) -> Tensor:
    tau = compensator.lead
    x = motion.yd + tau[0] * motion.yd_dot + tau[1] * motion.yd_ddot
    h = states(
        x[0], compensator.saturation.c, compensator.plays.r, compensator.creep_gains, compensator.creep_decay
    )
    return compensator.weighted(h[None], compensator.weights.basis(motion.yd_dot))


def _search(compensator: DirectInverse, pair: InversePair) -> int:
    """Run L-BFGS over all parameters, in place; return how often it evaluated loss and gradient."""
    optimizer = torch.optim.LBFGS(
        [p for p in compensator.parameters() if p.requires_grad and p.numel() > 0],
        max_iter=500,
        history_size=100,
        tolerance_grad=1e-10,
        tolerance_change=1e-13,
        line_search_fn="strong_wolfe",
    )
    evaluations = 0

    def closure() -> Tensor:
        nonlocal evaluations
        evaluations += 1
        optimizer.zero_grad()
        loss = _loss(compensator.voltage(pair.motion)[0], pair)
        loss.backward()
        return loss

    optimizer.step(closure)
    return evaluations


def _loss(u: Tensor, pair: InversePair) -> Tensor:
    return (u - pair.u).square().mean()


class _Step(nn.Module):
    """One step, with its state in tensors."""

    def __init__(self, compensator: DirectInverse) -> None:
        super().__init__()
        for name, value in {
            "tau": compensator.lead,
            "gains": compensator.creep_gains,
            "decay": compensator.creep_decay,
            "c": compensator.saturation.c,
            "r": compensator.plays.r,
            "b": compensator.weights.theta[:, 0],
            "k": compensator.weights.theta[:, 1] / compensator.weights.rate_scale_um_s,
            "xi": torch.zeros_like(compensator.creep_decay),
            "h": torch.zeros_like(compensator.plays.r),
        }.items():
            self.register_buffer(name, value.detach().clone())

    def forward(self, y: float, rate: float, acceleration: float) -> float:
        x = y + self.tau[0] * rate + self.tau[1] * acceleration
        s = x + torch.sum(self.gains * self.xi)
        self.xi = self.decay * self.xi + (1 - self.decay) * x
        total = torch.zeros_like(s)
        for i in range(self.c.shape[0] - 1, -1, -1):
            total = (total + self.c[i]) * s
        self.h = torch.maximum(total - self.r, torch.minimum(total + self.r, self.h))
        return float(torch.sum((self.b + self.k * rate) * self.h))


def _frozen(step: nn.Module) -> Any:
    return torch.jit.freeze(torch.jit.script(step))


def _without_gradients(step: Any) -> Callable[[float, float, float], float]:
    def one(y: float, rate: float, acceleration: float) -> float:
        with torch.no_grad():
            return float(step(y, rate, acceleration))

    return one


_SETTINGS = (
    "The same equations, {} over samples; `torch.optim.LBFGS` over all parameters from the two stages. Time: "
    "one evaluation, measured, times their number."
)
EAGER = Peer(
    "PyTorch, eager loop",
    "torch",
    _SETTINGS.format("a Python loop"),
    "anything, and nothing fast that walks through time.",
    fit_eager,
)
SCRIPTED = Peer(
    "PyTorch, TorchScript loop",
    "torch",
    _SETTINGS.format("a scripted loop"),
    "the same, for deployment without Python.",
    fit_scripted,
)
