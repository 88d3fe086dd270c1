"""Time the multi-axis steps in C that `torchpi export` writes, and a prediction in Python.

    python benchmarks/multi_axis_steps.py exports/mirror [--samples 1000]

The fastest of several blocks counts, because other load on the machine can only add time.
"""

import argparse
import ctypes
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import torch

from torchpi.export.multi_axis.c_source import FLAGS
from torchpi.stage.multi_axis import MultiAxisStage

BLOCKS = 200
STATE_BYTES = 1 << 24


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("exported", type=Path, help="path without suffix")
    parser.add_argument("--samples", type=int, default=1000)
    options = parser.parse_args()
    torch.set_num_threads(1)
    name = options.exported.name
    stage = MultiAxisStage.load(options.exported.with_name(f"{name}_stage.pt"))
    random = np.random.default_rng(0)
    for file in (f"{name}_forward", name):
        if (source := options.exported.with_name(f"{file}.c")).is_file():
            print(f"{file}: {in_c(source, options.samples, random):.3g} µs a step in C")
    u = torch.from_numpy(random.uniform(-0.3, 0.3, (1, options.samples, stage.inputs)))
    stage.simulate(u)
    began = time.perf_counter()
    stage.simulate(u)
    print(f"prediction: {1e6 * (time.perf_counter() - began) / options.samples:.3g} µs a sample in Python")


def in_c(source: Path, samples: int, random: np.random.Generator) -> float:
    """Return the time per step of the compiled source, µs."""
    header = dict(
        line.split()[1:3] for line in source.with_suffix(".h").read_text().splitlines() if "PUTS" in line
    )
    given, taken = (
        np.zeros((samples, int(header[f"{source.stem}_{word}"]))) for word in ("INPUTS", "OUTPUTS")
    )
    given[:] = random.uniform(-0.3, 0.3, given.shape)
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "step.so"
        subprocess.run(["cc", *FLAGS.split(), "-shared", "-fPIC", source, "-lm", "-o", library], check=True)
        loaded, state = ctypes.CDLL(str(library)), ctypes.create_string_buffer(STATE_BYTES)
        getattr(loaded, f"{source.stem}_reset")(state)
        block, quickest = getattr(loaded, f"{source.stem}_block"), np.inf
        ends = [ctypes.c_void_p(one.ctypes.data) for one in (given, taken)]
        for _ in range(BLOCKS):
            began = time.perf_counter()
            block(state, *ends, ctypes.c_size_t(samples))
            quickest = min(quickest, time.perf_counter() - began)
    return 1e6 * float(quickest) / samples


if __name__ == "__main__":
    main()
