"""Hostile sequences through an exported step: how many leave the limits, or more than 0.1 % a second later.

    python benchmarks/hostile_steps.py [--sequences 10000] [--script_sequences 200]
        [--steady_steps 1000000000] [--sanitized_steps 10000000]

C in double and float take all the sequences, TorchScript and the Python stream the first `script_sequences`,
compared with C to the last bit. Then one period over and over: how far its voltages drift. Then steps under
the address and undefined-behaviour sanitizers.
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.export.c_compiler import Stepped
from tests.hostile.sequences import VOLTAGES_V, compensator, disturbed, like_the_demo, motion
from torchpi.control.direct_inverse import DirectInverse
from torchpi.export import export_files, load_torchscript


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sequences", type=int, default=10_000)
    parser.add_argument("--script_sequences", type=int, default=200)
    parser.add_argument("--steady_steps", type=int, default=1_000_000_000)
    parser.add_argument("--sanitized_steps", type=int, default=10_000_000)
    options = parser.parse_args()
    for name, made in {"of every part": compensator(), "like the demo's": like_the_demo()}.items():
        print(f"A compensator {name}, at {1 / made.sample_period_s:g} Hz", flush=True)
        with tempfile.TemporaryDirectory() as folder:
            export_files(made, Path(folder) / "demo", ("torchscript", "c"))
            recovery(made, Path(folder), options.sequences)
            bits(made, Path(folder), options.script_sequences)
            drift(made, Path(folder), options.steady_steps)
            sanitized(Path(folder), options.sanitized_steps)


def recovery(made: DirectInverse, folder: Path, sequences: int) -> None:
    period_s = made.sample_period_s
    wait, samples = round(1.0 / period_s), round(1.5 / period_s)
    span = VOLTAGES_V[1] - VOLTAGES_V[0]
    for name, single in (("double", False), ("float", True)):
        step = Stepped(folder / "demo.c", single)
        undisturbed = step.block(motion(samples, period_s))
        outside, late, worst = 0, 0, 0.0
        for seed in range(sequences):
            yd, end = disturbed(seed, samples, period_s)
            step.reset()
            u = step.block(yd)
            outside += not bool(((u >= VOLTAGES_V[0]) & (u <= VOLTAGES_V[1])).all())
            left = float((u - undisturbed)[end + wait :].abs().max()) / span
            late += left > 1e-3
            worst = max(worst, left)
        print(
            f"C {name}: {sequences} sequences, {outside} outside the limits, {late} more than 0.1 % of the "
            f"voltage range off after 1 s, the worst {100 * worst:.2g} %",
            flush=True,
        )


def bits(made: DirectInverse, folder: Path, sequences: int) -> None:
    c, script, stream = (
        Stepped(folder / "demo.c"),
        load_torchscript(folder / "demo.pt"),
        made.stream(),
    )
    differing = 0
    for seed in range(sequences):
        yd, end = disturbed(seed, 4000, made.sample_period_s)
        yd = yd[: end + 60]
        c.reset()
        expected = c.block(yd).view(torch.int64)
        for one in (script, stream):
            one.reset()
            differing += not torch.equal(one.block(yd).view(torch.int64), expected)
    print(f"TorchScript and Python: {sequences} sequences, {differing} with other bits than C", flush=True)


def drift(made: DirectInverse, folder: Path, steps: int) -> None:
    period = motion(round(0.2 / made.sample_period_s), made.sample_period_s)
    periods = period.repeat(200_000 // len(period))
    for name, single in (("double", False), ("float", True)):
        step = Stepped(folder / "demo.c", single)
        step.block(periods)  # creep settles
        before = after = step.block(periods)
        for _ in range(steps // len(periods)):
            after = step.block(periods)
        off = float((after - before).abs().max())
        print(f"C {name}: {steps} steps, drift of {off:.2g} V", flush=True)


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
