"""Time a training pass, forward and backward: the play bank, and the whole compensator in one kernel.

    python benchmarks/training_pass.py [--samples 100000] [--plays 10] [--rounds 20]

Times are compared with a floor, the least memory traffic at the bandwidth of a large copy, and with the eager
loop over samples, which is timed over 10,000 samples and scaled up (its time grows at least in proportion).
"""

import argparse
import time
from collections.abc import Callable

import torch
from torch import Tensor

from torchpi.control.direct_inverse import DirectInverse
from torchpi.operators import play_bank, polynomial
from torchpi.operators.conformance import wandering
from torchpi.operators.motion import Motion, backward_motion
from torchpi.operators.play_scan import play_scan

PERIOD_S = 1e-4
COPIED_BYTES = 2 * 2**27  # read and written; far beyond the caches of a core
# Numbers per sample that must pass through memory. The bank reads x and writes h, reads the gradient of h and
# writes that of x. The compensator, which need not store h, reads y_d and ẏ_d and writes u; in the backward
# pass it reads these two and the gradient of u, and writes that of y_d.
BANK_NUMBERS = 2  # plus 2 per play
FUSED_NUMBERS = 7


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--samples", type=int, default=100_000)
    parser.add_argument("--plays", type=int, default=10)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--eager-samples", type=int, default=10_000)
    options = parser.parse_args()
    torch.set_num_threads(1)
    bank, fused = "play bank", "whole compensator, one kernel"
    x, r, model, motion = _inputs(options.samples, options.plays)
    few = Motion(*(part[:, : options.eager_samples] for part in motion))
    scaled = options.samples / options.eager_samples
    eager = {
        bank: scaled * _least_ms([_bank_pass(_eager_bank, few.yd, r)], 3)[0],
        fused: scaled * _least_ms([_model_pass(_eager_voltage, model, few)], 3)[0],
    }
    same = torch.equal(model.voltage(few)[0], _eager_voltage(model, few))
    print(
        f"{options.samples:,} samples × {options.plays} plays, forward + backward, least of {options.rounds}"
    )
    print(f"eager loop gives the same bits: {'yes' if same else 'NO'}\n")
    print(
        f"{'':32}{'':>9}{'threads':>8}{'ms':>9}{'floor, ms':>11}{'× floor':>9}{'× faster than the loop':>24}"
    )
    for dtype in (torch.float64, torch.float32):
        numbers = {bank: BANK_NUMBERS + 2 * options.plays, fused: FUSED_NUMBERS}
        for threads in (1, 2):
            passes = {
                bank: _bank_pass(play_bank, x.to(dtype), r.to(dtype)),
                fused: _model_pass(_voltage, model, Motion(*(part.to(dtype) for part in motion))),
            }
            copy_ms, *times = _least_ms([_copy(), *passes.values()], options.rounds, threads)
            for (name, count), milliseconds in zip(numbers.items(), times, strict=True):
                floor = copy_ms * count * options.samples * dtype.itemsize / COPIED_BYTES
                print(
                    f"{name:32}{str(dtype)[6:]:>9}{threads:8}{milliseconds:9.2f}{floor:11.2f}"
                    f"{milliseconds / floor:9.1f}{eager[name] / milliseconds:24,.0f}"
                )
    scan = _least_ms([_bank_pass(play_scan, x, r)], 3)[0]
    print(f"{'play bank by scan, plain torch':32}{'float64':>9}{1:8}{scan:9.1f}{eager[bank] / scan:44,.0f}")
    print(f"\nlarge copy: {COPIED_BYTES / copy_ms / 1e6:.1f} GB/s; eager loops, scaled up, float64: ", end="")
    print(", ".join(f"{name} {milliseconds:,.0f} ms" for name, milliseconds in eager.items()))


def _inputs(samples: int, plays: int) -> tuple[Tensor, Tensor, DirectInverse, Motion]:
    x = 4 * wandering(1, samples)
    r = torch.linspace(0, 3, plays, dtype=torch.float64)
    motion = backward_motion(x, PERIOD_S)
    model = DirectInverse(
        PERIOD_S, r.tolist(), range_um=8.0, rate_scale_um_s=float(motion.yd_dot.abs().max())
    )
    model.saturation.set_coefficients(torch.tensor([1.0, 0.02, -0.003, 0.0002], dtype=torch.float64))
    with torch.no_grad():
        model.weights.theta.copy_(torch.randn(model.weights.theta.shape, dtype=torch.float64))
    return x, r, model, motion


def _bank_pass(bank: Callable[[Tensor, Tensor, Tensor], Tensor], x: Tensor, r: Tensor) -> Callable[[], None]:
    x, r, h0 = (part.clone().requires_grad_() for part in (x, r, torch.zeros(1, len(r), dtype=x.dtype)))
    upstream = torch.ones(*x.shape, len(r), dtype=x.dtype)
    return lambda: _pass_through(bank(x, r, h0), upstream, (x, r, h0))


def _model_pass(
    voltage: Callable[[DirectInverse, Motion], Tensor], model: DirectInverse, motion: Motion
) -> Callable[[], None]:
    yd = motion.yd.clone().requires_grad_()
    inputs = (yd, *(part for part in model.parameters() if part.requires_grad and part.numel() > 0))
    upstream = torch.ones_like(yd)
    return lambda: _pass_through(voltage(model, motion._replace(yd=yd)), upstream, inputs)


def _pass_through(output: Tensor, upstream: Tensor, inputs: tuple[Tensor, ...]) -> None:
    torch.autograd.grad(output, inputs, upstream, allow_unused=True)


def _voltage(model: DirectInverse, motion: Motion) -> Tensor:
    return model.voltage(motion)[0]


def _eager_bank(x: Tensor, r: Tensor, h: Tensor) -> Tensor:
    states = []
    for t in range(x.shape[1]):
        h = torch.maximum(x[:, t, None] - r, torch.minimum(x[:, t, None] + r, h))
        states.append(h)
    return torch.stack(states, 1)


def _eager_voltage(model: DirectInverse, motion: Motion) -> Tensor:
    """Eq. 8 sample by sample, as a newcomer would write it; it sums left to right, as the kernel does."""
    c, r, theta = list(model.saturation.c), model.plays.r, model.weights.theta
    h = torch.zeros_like(r)
    voltages = []
    for t in range(motion.yd.shape[1]):
        s = polynomial(motion.yd[0, t], c)
        h = torch.maximum(s - r, torch.minimum(s + r, h))
        w = theta[:, 0] + theta[:, 1] * (motion.yd_dot[0, t] / model.weights.rate_scale_um_s)
        voltages.append((w * h).cumsum(0)[-1])
    return torch.stack(voltages)[None]


def _copy() -> Callable[[], None]:
    source = torch.ones(COPIED_BYTES // 16, dtype=torch.float64)
    target = torch.zeros_like(source)
    return lambda: _copy_once(source, target)


def _copy_once(source: Tensor, target: Tensor) -> None:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    target.copy_(source)
    torch.set_num_threads(threads)


def _least_ms(passes: list[Callable[[], None]], rounds: int, threads: int = 1) -> list[float]:
    """Return the least time of each pass, taken in turns: other load on the machine can only add to it.

    Every turn runs a pass three times, as an epoch does, because after a large copy the first one must read
    even its instructions from memory.
    """
    torch.set_num_threads(threads)
    least = [float("inf")] * len(passes)
    for turn in range(rounds + 1):
        for k, once in enumerate(passes):
            for _ in range(3):
                start = time.perf_counter()
                once()
                if turn > 0:  # the first turn compiles
                    least[k] = min(least[k], 1e3 * (time.perf_counter() - start))
    torch.set_num_threads(1)
    return least


if __name__ == "__main__":
    main()
