"""Feed hostile sequences to an exported step; count those that leave the limits or do not recover.

    python benchmarks/hostile_steps.py [--sequences 10000] [--first_seed 0] [--whole_every 100]
        [--steady_steps 1000000000] [--sanitized_steps 10000000]
        [--only recovery,bits,drift,sanitizers] [--compensator parts,demo]

`recovery` runs every sequence to its end in C (double and float); one that is off by more than 0.1 % of the
voltage range a second later has not recovered. `bits` compares TorchScript and the Python stream bit by bit
with C in double: until 60 samples after the last hostile one, and for every `whole_every`-th sequence over
all 1.5 s. The motion before the first hostile sample is the same in all sequences, so the two slow forms step
through it once and start each sequence from a copy of that state. Counts are printed at each tenth; an
interrupted run is continued from there with `--first_seed`. `drift` repeats one period and reports the
largest deviation of its voltages from the first round after creep has settled. `sanitizers` runs steps under
the address and undefined-behaviour sanitizers.
"""

import argparse
import copy
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Collection
from itertools import pairwise
from pathlib import Path

import torch
from torch import Tensor

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.export.c_compiler import Stepped
from tests.hostile.sequences import VOLTAGES_V, compensator, disturbed, hostile, like_the_demo, motion
from torchpi.control.direct_inverse import DirectInverse
from torchpi.control.step import CompensatorStream
from torchpi.export import export_files, load_torchscript

PRECISIONS = {"double": False, "float": True}
COMPENSATORS: dict[str, tuple[str, Callable[[], DirectInverse]]] = {
    "parts": ("of every part", compensator),
    "demo": ("like the demo's", like_the_demo),
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sequences", type=int, default=10_000)
    parser.add_argument("--first_seed", type=int, default=0, help="of the sequences")
    parser.add_argument("--whole_every", type=int, default=100)
    parser.add_argument("--steady_steps", type=int, default=1_000_000_000)
    parser.add_argument("--sanitized_steps", type=int, default=10_000_000)
    parser.add_argument("--only", default="recovery,bits,drift,sanitizers")
    parser.add_argument("--compensator", default="parts,demo")
    options = parser.parse_args()
    torch.set_num_threads(1)
    seeds = range(options.first_seed, options.first_seed + options.sequences)
    for key in options.compensator.split(","):
        name, make = COMPENSATORS[key]
        made = make()
        print(f"A compensator {name}, at {1 / made.sample_period_s:g} Hz", flush=True)
        with tempfile.TemporaryDirectory() as folder:
            export_files(made, Path(folder) / "demo", ("torchscript", "c"))
            parts: dict[str, Callable[[], None]] = {
                "recovery": lambda made=made, at=Path(folder): recovery(made, at, seeds),
                "bits": lambda made=made, at=Path(folder): bits(made, at, seeds, options.whole_every),
                "drift": lambda made=made, at=Path(folder): drift(made, at, options.steady_steps),
                "sanitizers": lambda at=Path(folder): sanitized(at, options.sanitized_steps),
            }
            for part in options.only.split(","):
                parts[part]()


def recovery(made: DirectInverse, folder: Path, seeds: range) -> None:
    period_s = made.sample_period_s
    wait, samples = round(1.0 / period_s), round(1.5 / period_s)
    span = VOLTAGES_V[1] - VOLTAGES_V[0]
    for name, single in PRECISIONS.items():
        step = Stepped(folder / "demo.c", single)
        undisturbed = step.block(motion(samples, period_s))
        outside, late, worst = 0, [], 0.0
        for seed in seeds:
            yd, end = disturbed(seed, samples, period_s)
            step.reset()
            u = step.block(yd)
            outside += not bool(((u >= VOLTAGES_V[0]) & (u <= VOLTAGES_V[1])).all())
            left = float((u - undisturbed)[end + wait :].abs().max()) / span
            late += [seed] if left > 1e-3 else []
            worst = max(worst, left)
        print(
            f"C {name}: {len(seeds)} sequences, {outside} outside the limits, {len(late)} more than 0.1 % of "
            f"the voltage range off after 1 s {late}, the worst {100 * worst:.2g} %",
            flush=True,
        )


def bits(made: DirectInverse, folder: Path, seeds: range, whole_every: int) -> None:
    c, script, python = Stepped(folder / "demo.c"), load_torchscript(folder / "demo.pt"), made.stream()
    differing = {"TorchScript": 0, "Python": 0}
    outside, whole, started = 0, 0, time.monotonic()
    samples = round(1.5 / made.sample_period_s)
    for some in tenths(seeds):
        in_full = [seed for seed in some if seed % whole_every == 0]
        for name, one in (("TorchScript", script), ("Python", python)):
            for seed in in_full:
                yd, _ = disturbed(seed, samples, made.sample_period_s)
                c.reset()
                one.reset()
                differing[name] += not same_bits(one.block(yd), c.block(yd))
            differing[name] += with_other_bits(one, c, made.sample_period_s, set(some).difference(in_full))
        for seed in some:
            yd, _ = disturbed(seed, samples, made.sample_period_s)
            c.reset()
            u = c.block(yd)
            outside += not bool(((u >= VOLTAGES_V[0]) & (u <= VOLTAGES_V[1])).all())
        whole += len(in_full)
        print(
            f"TorchScript, Python and C double: seeds {seeds[0]} to {some[-1]}, {whole} of them whole, "
            f"{outside} outside the limits; with other bits than C: "
            + ", ".join(f"{n} {name}" for name, n in differing.items())
            + f", after {time.monotonic() - started:.0f} s",
            flush=True,
        )


def with_other_bits(
    stream: CompensatorStream, c: Stepped, period_s: float, seeds: Collection[int], after: int = 60
) -> int:
    """Count the sequences that differ in any bit until `after` samples after their last hostile one.

    All sequences share the motion before their first hostile sample: it is stepped through once, and each
    sequence starts from a copy of the state reached there.
    """
    differing = 0
    samples = round(0.25 / period_s) + 40 + after  # the latest start, the longest sequence, the rest
    undisturbed = motion(samples, period_s)
    starts = {seed: disturbed(seed, samples, period_s)[1] - len(hostile(seed)) for seed in seeds}
    stream.reset()
    reached = 0
    so_far = torch.empty(0, dtype=torch.float64)
    for seed in sorted(starts, key=starts.__getitem__):
        start = starts[seed]
        so_far = torch.cat([so_far, stream.block(undisturbed[reached:start])])
        reached = start
        yd, end = disturbed(seed, samples, period_s)
        yd = yd[: end + after]
        c.reset()
        found = torch.cat([so_far, copy.deepcopy(stream).block(yd[start:])])
        differing += not same_bits(found, c.block(yd))
    return differing


def same_bits(one: Tensor, other: Tensor) -> bool:
    return torch.equal(one.view(torch.int64), other.view(torch.int64))


def drift(made: DirectInverse, folder: Path, steps: int) -> None:
    period = motion(round(0.2 / made.sample_period_s), made.sample_period_s)
    periods = period.repeat(200_000 // len(period))
    rounds = steps // len(periods)
    for name, single in PRECISIONS.items():
        step = Stepped(folder / "demo.c", single)
        for _ in range(3):  # creep settles
            step.block(periods)
        first, off, started = step.block(periods), 0.0, time.monotonic()
        for done in range(1, rounds + 1):
            off = max(off, float((step.block(periods) - first).abs().max()))
            progress(done, rounds, started)
        print(f"C {name}: {rounds * len(periods)} steps, drift of {off:.2g} V", flush=True)


def progress(done: int, of: int, started: float) -> None:
    """Print a line to standard error at each tenth of a long loop."""
    lasted = time.monotonic() - started
    if tenth(done, of) and lasted > 5.0:
        print(f"  {100 * done // of} % after {lasted:.0f} s", file=sys.stderr, flush=True)


def tenth(done: int, of: int) -> bool:
    """Whether the last step completed another tenth."""
    return done * 10 // of > (done - 1) * 10 // of


def tenths(seeds: range) -> list[range]:
    edges = [len(seeds) * k // 10 for k in range(11)]
    return [seeds[first:last] for first, last in pairwise(edges) if last > first]


def sanitized(folder: Path, steps: int) -> None:
    hammer = Path(__file__).parents[1] / "tests" / "hostile" / "hammer.c"
    for name, flags in (("double", []), ("float", ["-Ddemo_FLOAT32"])):
        program = folder / f"hammer_{name}"
        command = ["cc", "-std=c99", "-ffp-contract=off", "-O1", "-fsanitize=address,undefined"]
        command += ["-fno-sanitize-recover=all", f"-I{folder}", *flags, str(hammer), str(folder / "demo.c")]
        subprocess.run([*command, "-o", str(program)], check=True)
        done = subprocess.run([str(program), str(steps)], capture_output=True, text=True)
        print(
            f"C {name} under the sanitizers: {steps} steps, exit code {done.returncode} {done.stdout}",
            flush=True,
        )


if __name__ == "__main__":
    main()
