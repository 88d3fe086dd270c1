"""One training pass of the play bank: compiled kernel and scan against the eager loop over samples.

    python benchmarks/training_pass.py [--samples 100000] [--plays 10] [--repeats 7]

The eager loop is timed over fewer samples (its time grows at least in proportion) and scaled up.
"""

import argparse
import statistics
import time
from collections.abc import Callable

import torch
from torch import Tensor

from torchpi.operators import play_bank
from torchpi.operators.conformance import wandering
from torchpi.operators.play_scan import play_scan


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--samples", type=int, default=100_000)
    parser.add_argument("--plays", type=int, default=10)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--eager-samples", type=int, default=10_000)
    options = parser.parse_args()
    torch.set_num_threads(1)
    x = 4 * wandering(1, options.samples)
    r = torch.linspace(0, 3, options.plays, dtype=torch.float64)

    few = x[:, : options.eager_samples]
    assert torch.equal(play_bank(few, r, _zeros(r)), _eager_loop(few, r, _zeros(r)))
    eager = _median_ms(_eager_loop, few, r, 3) * options.samples / options.eager_samples
    rows = {
        "eager loop over samples (scaled up)": eager,
        "associative scan, plain torch": _median_ms(play_scan, x, r, options.repeats),
        "compiled kernel": _median_ms(play_bank, x, r, options.repeats),
    }
    print(f"forward + backward, {options.samples:,} samples × {options.plays} plays, float64, one thread")
    for name, milliseconds in rows.items():
        print(f"{name:38}{milliseconds:12,.1f} ms{eager / milliseconds:12,.0f} × faster than the loop")


def _eager_loop(x: Tensor, r: Tensor, h: Tensor) -> Tensor:
    states = []
    for t in range(x.shape[1]):
        h = torch.maximum(x[:, t, None] - r, torch.minimum(x[:, t, None] + r, h))
        states.append(h)
    return torch.stack(states, 1)


def _median_ms(bank: Callable[[Tensor, Tensor, Tensor], Tensor], x: Tensor, r: Tensor, repeats: int) -> float:
    times = []
    for _ in range(repeats + 1):
        inputs = x.clone().requires_grad_(), r.clone().requires_grad_(), _zeros(r).requires_grad_()
        start = time.perf_counter()
        states = bank(*inputs)
        states.backward(torch.ones_like(states))
        times.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times[1:])  # the first call compiles


def _zeros(r: Tensor) -> Tensor:
    return torch.zeros(1, len(r), dtype=torch.float64)


if __name__ == "__main__":
    main()
