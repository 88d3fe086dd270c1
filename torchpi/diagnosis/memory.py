"""Return freed memory to the operating system."""

import ctypes
import os
import time
from collections.abc import Callable

EVERY_S = 3.0
"""Minimum time between two returns: arrays that are needed again soon cost more than they take."""


class _Returned:
    trim: Callable[[int], int] | None = (
        getattr(ctypes.CDLL(None), "malloc_trim", None) if os.name == "posix" else None
    )
    last_s = -EVERY_S


def return_memory() -> None:
    """Return freed memory, at most every few seconds.

    The C library of Linux keeps freed arrays of a megabyte, and the gaps between them: a process whose arrays
    take one gigabyte would hold two. Other systems are left as they are.
    """
    if _Returned.trim is not None and time.monotonic() - _Returned.last_s >= EVERY_S:
        _Returned.trim(0)
        _Returned.last_s = time.monotonic()
