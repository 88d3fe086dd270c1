"""Memory that a search no longer needs is returned to the operating system."""

import subprocess
import sys

import pytest

from torchpi.diagnosis import memory

ALLOCATES_AND_FREES = """
import numpy as np
from torchpi.diagnosis.memory import return_memory

def resident_mb():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096 / 1e6

np.ones(4_000_000)  # from its size on, the C library no longer maps each array separately
arrays = [np.ones(100_000) for _ in range(200)]
full = resident_mb()
arrays = arrays[::2]
freed = resident_mb()
return_memory()
print(full - freed, full - resident_mb())
"""


@pytest.mark.skipif(memory._Returned.trim is None, reason="the C library has no malloc_trim")
def test_freed_arrays_between_others_are_returned() -> None:
    """Half of 160 MB are freed; each gap is smaller than what the C library returns by itself."""
    printed = subprocess.run(
        [sys.executable, "-c", ALLOCATES_AND_FREES], capture_output=True, text=True, check=True
    ).stdout
    by_itself, afterwards = map(float, printed.split())
    assert by_itself < 20.0 < 60.0 < afterwards


def test_memory_is_returned_only_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []
    monkeypatch.setattr(memory._Returned, "trim", calls.append)
    monkeypatch.setattr(memory._Returned, "last_s", -1e9)
    for _ in range(5):
        memory.return_memory()
    assert calls == [0]
