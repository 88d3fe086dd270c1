"""Measure the time of a training pass against the length of the record and the number of plays.

    python benchmarks/scaling.py [--figure docs/scaling.png]

Forward and backward, float64, one thread: the whole compensator in one kernel, which stores no states, and
the play bank, which does. The slope is that of the logarithms, so 1 means linear growth.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchpi.operators import play_bank
from torchpi.operators.weighted_plays import weighted_plays

SAMPLES = [10**3, 10**4, 10**5, 10**6, 10**7]
PLAYS = [1, 3, 10, 30, 100, 300, 1000]
FUSED, BANK = "whole compensator, one kernel", "play bank, states stored"
# The bank's states and their gradient, twice 8 bytes, of 10⁷ samples × 10 plays fill 1.6 GB.
MOST_STATES = 10**8


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--figure", type=Path, default=None)
    options = parser.parse_args()
    torch.set_num_threads(1)
    _pass_ms(FUSED, 1000, 2)
    _pass_ms(BANK, 1000, 2)
    curves = {}
    for name in (FUSED, BANK):
        against_samples = [(t, _pass_ms(name, t, 10)) for t in SAMPLES if 10 * t <= MOST_STATES]
        against_plays = [(n, _pass_ms(name, 10_000, n)) for n in PLAYS]
        curves[name] = against_samples, against_plays
        for label, points in (
            ("10 plays, samples", against_samples),
            ("10,000 samples, plays", against_plays),
        ):
            print(f"{name}, {label}: " + ", ".join(f"{count:,}: {ms:,.2f} ms" for count, ms in points))
            print(f"    slope of the last decades: {_slope(points[-3:]):.2f}")
    if options.figure is not None:
        _draw(curves, options.figure)


def _pass_ms(name: str, samples: int, plays: int) -> float:
    """Return the least time of several passes: other load on the machine can only add to it."""
    # Strokes of many sizes, a hundred samples each, whatever the length of the record.
    t = torch.arange(samples, dtype=torch.float64)
    x = (4 * torch.sin(0.06 * t) * torch.cos(0.0017 * t))[None].requires_grad_()
    r = torch.linspace(0, 3, plays, dtype=torch.float64)
    h0 = torch.zeros(1, plays, dtype=torch.float64)
    c = torch.tensor([1.0, 0.02, -0.003, 0.0002], dtype=torch.float64, requires_grad=True)
    theta = torch.ones(plays, 2, dtype=torch.float64, requires_grad=True)
    rate = torch.cos(0.06 * t)[None]
    none = torch.zeros(plays, 0, dtype=torch.float64), torch.zeros((), dtype=torch.float64)
    upstream = torch.ones(1, samples, plays, dtype=torch.float64) if name == BANK else torch.ones(1, samples)
    times: list[float] = []
    while len(times) < 3 or (len(times) < 30 and sum(times) < 1e3):
        start = time.perf_counter()
        if name == BANK:
            _backward(play_bank(x, r, h0), upstream, x)
        else:
            u, _ = weighted_plays(x, rate, h0, c, r, theta, torch.zeros(0, 2, dtype=torch.float64), *none)
            _backward(u, upstream.double(), x, c, theta)
        times.append(1e3 * (time.perf_counter() - start))
    return min(times)


def _backward(output: Tensor, upstream: Tensor, *inputs: Tensor) -> None:
    torch.autograd.grad(output, inputs, upstream)


def _slope(points: list[tuple[int, float]]) -> float:
    counts, times = np.log(np.array(points)).T
    return float(np.polyfit(counts, times, 1)[0])


def _draw(curves: dict[str, tuple[list[tuple[int, float]], ...]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(7.5, 3.4), sharey=True, layout="constrained")
    for axis, which, label in zip(
        axes, (0, 1), ("samples T (n = 10 plays)", "plays n (T = 10,000 samples)"), strict=True
    ):
        for (name, panels), marker, colour in zip(curves.items(), "os", ("#0072b2", "#d55e00"), strict=True):
            counts, times = zip(*panels[which], strict=True)
            axis.loglog(counts, times, marker=marker, color=colour, label=name)
        end, ms = panels[which][-1]
        begin = panels[which][0][0]
        axis.loglog([begin, end], [ms * begin / end, ms], ":", color="0.4", label="linear")
        axis.set_xlabel(label, fontsize=10)
        axis.grid(True, which="major", color="0.9")
    axes[0].set_ylabel("forward + backward, ms", fontsize=10)
    axes[0].legend(fontsize=8.5, frameon=False)
    figure.savefig(path, dpi=200)


if __name__ == "__main__":
    main()
