"""One compensator step called from Python: the exported form against two simpler ways to write it.

    python benchmarks/step_latency.py [exports/NAME.pt] [--steps 20000]

All are scripted and frozen, and called in turn, so that a busy machine slows all of them.
"""

import argparse
import math
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from torchpi.compensator import DirectInverse
from torchpi.export import load_torchscript
from torchpi.export.torchscript import script

THRESHOLDS = [0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 1.5, 2.0, 3.0]  # of the paper
COEFFICIENTS = [1.40, -7.62e-2, 1.45e-2, -7.53e-4]  # eq. 12, c_1 first


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("compensator", type=Path, nargs="?", help="an exported file to time as well")
    parser.add_argument("--steps", type=int, default=20_000)
    options = parser.parse_args()
    torch.set_num_threads(1)
    warnings.filterwarnings("ignore", message=".*torch.jit.*deprecated.*")
    paper = _paper_compensator()
    k, b = paper.weights.k.detach(), paper.weights.b.detach()
    steps = {
        "state in tensors": _frozen(_TensorState(k, b)),
        "loop over lists": _frozen(_ListState(k.tolist(), b.tolist())),
        "exported form, n = 10, m = 4, linear": script(paper),
    }
    if options.compensator:
        steps[str(options.compensator)] = load_torchscript(options.compensator)

    trajectory = [4 - 3.5 * math.cos(0.02 * i) + 0.3 * math.sin(0.31 * i) for i in range(options.steps)]
    times = {name: np.empty(options.steps) for name in steps}
    for module in steps.values():
        for y in trajectory[:1000]:
            module.step(y)
    for start in range(0, options.steps, 500):
        for name, module in steps.items():
            for i in range(start, min(start + 500, options.steps)):
                before = time.perf_counter_ns()
                module.step(trajectory[i])
                times[name][i] = time.perf_counter_ns() - before
    reference = np.median(times["state in tensors"])
    print(f"{'one step from Python, µs':40}{'median':>9}{'p99':>9}{'p99.9':>9}{'median, of tensors':>21}")
    for name, t in times.items():
        median, p99, p999 = np.percentile(t, [50, 99, 99.9]) / 1e3
        print(f"{name:40}{median:9.2f}{p99:9.2f}{p999:9.2f}{np.median(t) / reference:20.2f}×")


def _paper_compensator() -> DirectInverse:
    compensator = DirectInverse(1e-4, THRESHOLDS, degree=4, rate="linear", rate_scale_um_s=800.0)
    compensator.saturation.set_coefficients(torch.tensor(COEFFICIENTS, dtype=torch.float64))
    with torch.no_grad():
        compensator.weights.theta.normal_(generator=torch.Generator().manual_seed(0))
    return compensator


class _TensorState(nn.Module):
    """Eq. 8 as one would write it at first: the states of the plays in one tensor."""

    def __init__(self, k: Tensor, b: Tensor) -> None:
        super().__init__()
        self.register_buffer("r", torch.tensor(THRESHOLDS, dtype=torch.float64))
        self.register_buffer("c", torch.tensor(COEFFICIENTS, dtype=torch.float64))
        self.register_buffer("k", k)
        self.register_buffer("b", b)
        self.register_buffer("h", torch.zeros(len(THRESHOLDS), dtype=torch.float64))
        self.register_buffer("previous", torch.zeros((), dtype=torch.float64))

    @torch.jit.export
    def step(self, yd: float) -> float:
        y = torch.full((), yd, dtype=torch.float64)
        rate = (y - self.previous) / 1e-4
        self.previous = y
        s = torch.zeros_like(y)
        for i in range(self.c.shape[0] - 1, -1, -1):
            s = (s + self.c[i]) * y
        self.h = torch.maximum(s - self.r, torch.minimum(s + self.r, self.h))
        u = torch.sum((self.k * rate + self.b) * self.h)
        return float(torch.clamp(u, 0.0, 10.0))


class _ListState(nn.Module):
    """Eq. 8 as a loop over lists of floats."""

    r: list[float]
    c: list[float]
    k: list[float]
    b: list[float]
    h: list[float]

    def __init__(self, k: list[float], b: list[float]) -> None:
        super().__init__()
        self.r, self.c, self.k, self.b = THRESHOLDS, COEFFICIENTS, k, b
        self.h = [0.0] * len(THRESHOLDS)
        self.previous = 0.0

    @torch.jit.export
    def step(self, yd: float) -> float:
        rate = (yd - self.previous) / 1e-4
        self.previous = yd
        s = 0.0
        for i in range(len(self.c) - 1, -1, -1):
            s = (s + self.c[i]) * yd
        u = 0.0
        for i in range(len(self.r)):
            self.h[i] = max(s - self.r[i], min(s + self.r[i], self.h[i]))
            u += (self.k[i] * rate + self.b[i]) * self.h[i]
        return min(max(u, 0.0), 10.0)


def _frozen(module: nn.Module) -> Any:
    return torch.jit.freeze(torch.jit.script(module.eval()), preserved_attrs=["step"])


if __name__ == "__main__":
    main()
