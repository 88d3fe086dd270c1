"""Time one compensator step in TorchScript and C, called from Python and from C or C++.

    python benchmarks/step_latency.py [exports/NAME.pt] [--steps 20000] [--older CHECKOUT]

The variants called from Python take turns, so that other load on the machine slows all of them. So do the
generated C and a hand-written step, which replaces a non-finite input by the last finite one and has no other
guard: "C: generated over C: by hand" is the cost of the guards. If a checkout of an older version is given,
its generated step of the same model is timed in the same loop: "C: generated over C: older". Variants that
need a missing C or C++ compiler are left out with a message.
"""

import argparse
import ctypes
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from torchpi.control.direct_inverse import DirectInverse
from torchpi.export import export_files, load_torchscript

HERE = Path(__file__).parent
C_FLAGS = ["-std=c99", "-ffp-contract=off", "-O2"]
THRESHOLDS = [0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 1.5, 2.0, 3.0]  # the paper's thresholds
COEFFICIENTS = [1.40, -7.62e-2, 1.45e-2, -7.53e-4]  # eq. 12, c_1 first
# As in hand_written_step.c.
B = [1.10, -0.21, 0.04, -0.13, 0.02, -0.07, 0.03, -0.05, 0.01, -0.02]
K = [0.012, -0.003, 0.004, 0.001, -0.002, 0.006, -0.001, 0.002, -0.004, 0.003]
RATE_SCALE_UM_S = 800.0

Row = tuple[str, float, float]  # name, median and 99.9th percentile in µs


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("compensator", type=Path, nargs="?", help="an exported file to time as well")
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--older", type=Path, help="folder of another version, whose C step is timed as well")
    options = parser.parse_args()
    torch.set_num_threads(1)
    warnings.filterwarnings("ignore", message=".*torch.jit.*deprecated.*")
    with tempfile.TemporaryDirectory() as folder:
        rows = measure(Path(folder), options.compensator, options.steps, options.older)
    print(f"{'one step, µs':44}{'median':>10}{'p99.9':>10}")
    for name, median, p999 in rows:
        print(f"{name:44}{median:10.4g}{p999:10.4g}")
    print()
    medians = {name: median for name, median, _ in rows}
    for over, under in (
        ("Python: TorchScript", "Python: TorchScript, state in tensors"),
        ("Python: TorchScript", "Python: C"),
        ("C++: TorchScript", "C++: TorchScript, state in tensors"),
        ("C++: TorchScript", "C: generated"),
        ("C: generated", "C: by hand"),
        ("C: generated", "C: older"),
    ):
        if {over, under} <= medians.keys():
            print(f"{over} over {under}: {medians[over] / medians[under]:.3g} ×")


def measure(folder: Path, other: Path | None, steps: int, older: Path | None) -> list[Row]:
    compensator = paper_compensator()
    export_files(compensator, folder / "generated", ("torchscript", "c"))
    frozen(TensorState()).save(str(folder / "tensors.pt"))
    called: dict[str, Callable[[float], float]] = {
        "Python: TorchScript, state in tensors": torch.jit.load(folder / "tensors.pt").step,
        "Python: TorchScript, loop over lists": frozen(ListState()).step,
        "Python: TorchScript": load_torchscript(folder / "generated.pt").step,
    }
    if other:
        called[f"Python: {other}"] = load_torchscript(other).step
    has_c = shutil.which("cc") is not None
    if has_c:
        called["Python: C"], way = from_shared_library(folder)
        print(f"C is called from Python through {way}.")
    rows = from_python(called, steps)
    if has_c:
        rows += from_c(folder, steps, older)
    else:
        print("Without C: there is no cc.")
    if shutil.which("cmake") and shutil.which("c++"):
        rows += from_cpp(folder, steps)
    else:
        print("Without C++: there is no cmake, or no c++.")
    return rows


def from_python(called: dict[str, Callable[[float], float]], steps: int) -> list[Row]:
    trajectory = [4 - 3.5 * math.cos(0.02 * i) + 0.3 * math.sin(0.31 * i) for i in range(steps)]
    times = {name: np.empty(steps) for name in called}
    for step in called.values():
        for y in trajectory[:1000]:
            step(y)
    for start in range(0, steps, 500):
        for name, step in called.items():
            for i in range(start, min(start + 500, steps)):
                before = time.perf_counter_ns()
                step(trajectory[i])
                times[name][i] = time.perf_counter_ns() - before
    return [(name, *_percentiles(t / 1e3)) for name, t in times.items()]


def from_shared_library(folder: Path) -> tuple[Callable[[float], float], str]:
    """Return the C step as a Python callable, and the name of the interface."""
    library = folder / "generated.so"
    subprocess.run(
        ["cc", *C_FLAGS, "-shared", "-fPIC", str(folder / "generated.c"), "-o", str(library)], check=True
    )
    # Larger than the state of any model with ten plays.
    state = (ctypes.c_double * 64)()
    try:
        import cffi
    except ImportError:
        loaded = ctypes.CDLL(str(library))
        loaded.generated_step.restype = ctypes.c_double
        loaded.generated_step.argtypes = [ctypes.c_void_p, ctypes.c_double]
        place = ctypes.byref(state)
        loaded.generated_reset(place)
        return lambda yd: float(loaded.generated_step(place, yd)), "ctypes"
    ffi = cffi.FFI()
    ffi.cdef("void generated_reset(void *); double generated_step(void *, double);")
    opened = ffi.dlopen(str(library))
    held = ffi.from_buffer(state)
    opened.generated_reset(held)
    return lambda yd: float(opened.generated_step(held, yd)), "cffi"


def from_c(folder: Path, steps: int, older: Path | None) -> list[Row]:
    program = folder / "time_c_steps"
    sources = [folder / "generated.c", HERE / "hand_written_step.c", HERE / "time_c_steps.c"]
    flags, names = [*C_FLAGS, f"-I{folder}", f"-I{HERE}"], ["C: generated", "C: by hand"]
    if older:
        export_older(older, folder / "older")
        sources.append(folder / "older.c")
        flags.append("-DOLDER")
        names.append("C: older")
    subprocess.run(["cc", *flags, *map(str, sources), "-lm", "-o", str(program)], check=True)
    lines: list[str] = []
    for _ in range(5):  # a new process each time, because the memory location of the states matters
        done = subprocess.run([str(program), str(max(steps // 5, 1000))], capture_output=True, text=True)
        if done.returncode != 0:
            raise SystemExit(done.stdout)
        lines += done.stdout.splitlines()
    times = np.array([line.split() for line in lines], dtype=float) / 1e3
    return [(name, *_percentiles(t)) for name, t in zip(names, times.T, strict=True)]


def export_older(checkout: Path, output: Path) -> None:
    """Export the same model as C with the version in `checkout`, using its own copy of this file."""
    program = (
        "import pathlib, sys; sys.path.insert(0, 'benchmarks'); import step_latency; "
        "from torchpi.export import export_files; "
        "export_files(step_latency.paper_compensator(), pathlib.Path(sys.argv[1]), ('c',))"
    )
    subprocess.run(
        [sys.executable, "-c", program, str(output)],
        cwd=checkout,
        env={**os.environ, "PYTHONPATH": str(checkout.resolve())},
        check=True,
    )


def from_cpp(folder: Path, steps: int) -> list[Row]:
    """Build and run the loop of exports/cpp_loop, which prints the time of its steps."""
    build, source = folder / "build", HERE.parent / "exports" / "cpp_loop"
    prefix = f"-DCMAKE_PREFIX_PATH={torch.utils.cmake_prefix_path}"
    for command in (["-S", str(source), "-B", str(build), prefix], ["--build", str(build)]):
        subprocess.run(["cmake", *command], check=True, capture_output=True)
    rows = []
    for name, file in (
        ("C++: TorchScript, state in tensors", "tensors.pt"),
        ("C++: TorchScript", "generated.pt"),
    ):
        done = subprocess.run(
            [str(build / "loop"), str(folder / file), str(steps)], capture_output=True, text=True, check=True
        )
        median, p999 = re.findall(r"([\d.]+) us", done.stderr)
        rows.append((name, float(median), float(p999)))
    return rows


def paper_compensator() -> DirectInverse:
    compensator = DirectInverse(1e-4, THRESHOLDS, degree=4, rate="linear", rate_scale_um_s=RATE_SCALE_UM_S)
    compensator.saturation.set_coefficients(torch.tensor(COEFFICIENTS, dtype=torch.float64))
    with torch.no_grad():
        compensator.weights.theta.copy_(torch.tensor([B, K], dtype=torch.float64).T)
    return compensator


class TensorState(nn.Module):
    """A straightforward version of eq. 8, with the states of the plays in one tensor."""

    def __init__(self) -> None:
        super().__init__()
        self.sample_period_s = 1e-4
        self.preview = 0
        self.register_buffer("r", torch.tensor(THRESHOLDS, dtype=torch.float64))
        self.register_buffer("c", torch.tensor(COEFFICIENTS, dtype=torch.float64))
        self.register_buffer("k", torch.tensor(K, dtype=torch.float64) / RATE_SCALE_UM_S)
        self.register_buffer("b", torch.tensor(B, dtype=torch.float64))
        self.register_buffer("h", torch.zeros(len(THRESHOLDS), dtype=torch.float64))
        self.register_buffer("previous", torch.zeros((), dtype=torch.float64))

    @torch.jit.export
    def reset(self) -> None:
        self.h = torch.zeros_like(self.h)
        self.previous = torch.zeros_like(self.previous)

    @torch.jit.export
    def step(self, yd: float) -> float:
        y = torch.full((), yd, dtype=torch.float64)
        rate = (y - self.previous) / self.sample_period_s
        self.previous = y
        s = torch.zeros_like(y)
        for i in range(self.c.shape[0] - 1, -1, -1):
            s = (s + self.c[i]) * y
        self.h = torch.maximum(s - self.r, torch.minimum(s + self.r, self.h))
        u = torch.sum((self.k * rate + self.b) * self.h)
        return float(torch.clamp(u, 0.0, 10.0))


class ListState(nn.Module):
    """Eq. 8 as a loop over lists of floats."""

    r: list[float]
    c: list[float]
    k: list[float]
    b: list[float]
    h: list[float]

    def __init__(self) -> None:
        super().__init__()
        self.sample_period_s = 1e-4
        self.preview = 0
        self.r, self.c, self.b = THRESHOLDS, COEFFICIENTS, B
        self.k = [k / RATE_SCALE_UM_S for k in K]
        self.h = [0.0] * len(THRESHOLDS)
        self.previous = 0.0

    @torch.jit.export
    def reset(self) -> None:
        for i in range(len(self.h)):
            self.h[i] = 0.0
        self.previous = 0.0

    @torch.jit.export
    def step(self, yd: float) -> float:
        rate = (yd - self.previous) / self.sample_period_s
        self.previous = yd
        s = 0.0
        for i in range(len(self.c) - 1, -1, -1):
            s = (s + self.c[i]) * yd
        u = 0.0
        for i in range(len(self.r)):
            self.h[i] = max(s - self.r[i], min(s + self.r[i], self.h[i]))
            u += (self.k[i] * rate + self.b[i]) * self.h[i]
        return min(max(u, 0.0), 10.0)


def frozen(module: nn.Module) -> Any:
    kept = ["reset", "step", "sample_period_s", "preview"]
    return torch.jit.freeze(torch.jit.script(module.eval()), preserved_attrs=kept)


def _percentiles(times_us: "np.ndarray") -> tuple[float, float]:
    median, p999 = np.percentile(times_us, [50, 99.9])
    return float(median), float(p999)


if __name__ == "__main__":
    main()
