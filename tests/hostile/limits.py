"""Limits of time and memory: a test that would hang or fill the machine fails instead."""

import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

MOST_S = 10
MOST_BYTES = 4 * 2**30  # beyond what the process holds when the block begins


class TooLongError(BaseException):
    """Unlike TimeoutError, neither an Exception nor an OSError, which commands turn into a line on stderr."""


@contextmanager
def limited(seconds: int = MOST_S, most_bytes: int = MOST_BYTES) -> Iterator[None]:
    """Raise TooLongError after `seconds`, and MemoryError beyond `most_bytes` of additional memory."""

    def stop(_signal: int, _frame: FrameType | None) -> None:
        raise TooLongError(f"not done after {seconds} s")

    before, (soft, hard) = signal.signal(signal.SIGALRM, stop), resource.getrlimit(resource.RLIMIT_AS)
    with open("/proc/self/statm") as file:
        held = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (held + most_bytes, hard))
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
