"""The C compiler, for tests: strict flags, shared libraries, programs."""

import ctypes
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor

STRICT = ["-std=c99", "-ffp-contract=off", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
FLOAT = ["-Wdouble-promotion"]
needs_cc = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")

Outcome = subprocess.CompletedProcess[str]


def cc(*arguments: str | Path) -> Outcome:
    return subprocess.run(["cc", *STRICT, *map(str, arguments)], capture_output=True, text=True)


def built(program: Path, *arguments: str | Path) -> Path:
    done = cc(*arguments, "-o", program)
    assert done.returncode == 0, done.stderr
    return program


def run(program: Path, *arguments: str) -> Outcome:
    return subprocess.run([str(program), *arguments], capture_output=True, text=True)


class Stepped:
    """An exported NAME.c, compiled and loaded; each instance has its own state."""

    def __init__(self, source: Path, single: bool = False) -> None:
        suffix, flags = ("_float32", [f"-D{source.stem}_FLOAT32", *FLOAT]) if single else ("", [])
        library = source.with_name(f"{source.stem}{suffix}.so")
        if not library.exists():
            built(library, "-shared", "-fPIC", *flags, source)
        loaded = ctypes.CDLL(str(library))
        self._reset, self._step, self._block = (
            getattr(loaded, f"{source.stem}_{name}{suffix}") for name in ("reset", "step", "block")
        )
        self._step.restype = ctypes.c_double
        self._step.argtypes = [ctypes.c_void_p, ctypes.c_double]
        self._reset_at, self._reset_at_voltage = (
            getattr(loaded, f"{source.stem}_{name}{suffix}") for name in ("reset_at", "reset_at_voltage")
        )
        for start in (self._reset_at, self._reset_at_voltage):
            start.restype = ctypes.c_double
            start.argtypes = [ctypes.c_void_p, ctypes.c_double]
        # Larger than any state; the memory behind the state must stay unchanged.
        self._state = (ctypes.c_double * 4096)(*[1e300] * 4096)
        self.reset()

    def reset(self) -> None:
        self._reset(ctypes.byref(self._state))

    def reset_at(self, yd: float) -> float:
        return float(self._reset_at(ctypes.byref(self._state), yd))

    def reset_at_voltage(self, voltage_v: float) -> float:
        return float(self._reset_at_voltage(ctypes.byref(self._state), voltage_v))

    @property
    def step(self) -> Callable[[float], float]:
        return lambda yd: self._step(ctypes.byref(self._state), yd)

    def steps(self, yd: Tensor) -> Tensor:
        return torch.tensor([self.step(sample) for sample in yd.tolist()], dtype=torch.float64)

    def block(self, yd: Tensor) -> Tensor:
        u, count = torch.empty_like(yd), ctypes.c_size_t(len(yd))
        given, taken = ctypes.c_void_p(yd.data_ptr()), ctypes.c_void_p(u.data_ptr())
        self._block(ctypes.byref(self._state), given, taken, count)
        return u
