"""Current speed of this machine: its processors, and the share that other processes leave.

Nothing heavy is imported here, because the measurement runs within a second, before torch is imported.
"""

import hashlib
import threading
import time
from dataclasses import dataclass
from functools import cache
from statistics import median

from torchpi.cli.workers import available_cores

LOOPS, LOOPS_S = 300_000, 0.024
"""Iterations of a plain Python loop, and its processor time on the reference machine of `duration.py`."""
TIMES = 9
"""Number of runs of the loop: an idle processor starts slowly, and one that shares its core varies."""
WINDOW_S = 0.3
"""Time over which the share of one and of several threads is measured, longer than a scheduler's fairness."""
BLOCK = bytes(1 << 18)
"""Data that the threads hash meanwhile, which releases Python's global lock."""
FAIR = 0.6
"""Least assumed fraction of an equal share of the processors; less is taken to be temporary."""


@dataclass(frozen=True)
class Machine:
    """Computing power available to a process.

    Attributes:
        speed: Speed of a processor relative to the reference machine.
        alone: Processors available to one thread, at most 1.
        together: Processors available in total to the processes that a command starts.
    """

    speed: float
    alone: float
    together: float

    def seconds(self, alone: float, shared: float = 0.0) -> float:
        """Return the duration of work in processor seconds: `alone` in one thread, `shared` by several."""
        return (alone / self.alone + shared / self.together) / self.speed


@cache
def measured(processes: int) -> Machine:
    """Measure this machine for a command with this number of processes."""
    alone = _processors(1)
    return Machine(_speed(), alone, max(alone, _processors(processes)) if processes > 1 else alone)


def _speed() -> float:
    each = []
    for _ in range(TIMES):
        started, x = time.process_time(), 0
        for _ in range(LOOPS):
            x = (x * 1103515245 + 12345) & 0x7FFFFFFF
        each.append(time.process_time() - started)
    return LOOPS_S / max(median(each), 1e-6)


def _processors(threads: int) -> float:
    """Measure the processor time per second that busy threads get in total."""
    wall, processor = time.perf_counter(), time.process_time()
    busy = [threading.Thread(target=_work, args=(wall + WINDOW_S,)) for _ in range(threads)]
    for thread in busy:
        thread.start()
    waiting = []
    while any(thread.is_alive() for thread in busy):
        time.sleep(WINDOW_S / 15)
        waiting.append(_runnable())
    given = (time.process_time() - processor) / (time.perf_counter() - wall)
    processes = max(sum(waiting) / len(waiting), threads)
    return max(given, FAIR * threads * min(1.0, available_cores() / processes))


def _runnable() -> int:
    """Return the number of runnable processes and threads, including ours; 0 if the system does not tell."""
    try:
        with open("/proc/loadavg") as file:
            return int(file.read().split()[3].partition("/")[0])
    except (OSError, ValueError, IndexError):
        return 0


def _work(until: float) -> None:
    while time.perf_counter() < until:
        hashlib.sha256(BLOCK).digest()
