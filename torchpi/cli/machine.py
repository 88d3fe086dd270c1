"""How quick this machine is right now: its processors, and what other processes leave of them.

Nothing heavy is imported here: it is measured before torch is there, within a second.
"""

import hashlib
import threading
import time
from dataclasses import dataclass
from functools import cache
from statistics import median

from torchpi.cli.workers import available_cores

LOOPS, LOOPS_S = 300_000, 0.024
"""A loop of plain Python, and its processor time where the work of the commands was measured."""
TIMES = 9
"""That it runs: a processor that was idle is slow at first, one that shares its core by moments."""
WINDOW_S = 0.3
"""Of watching what one thread is given, and what several are: longer than a scheduler takes to be fair."""
BLOCK = bytes(1 << 18)
"""What the threads hash meanwhile; Python's lock is free then."""
FAIR = 0.6
"""Of an equal share of the processors, at least taken to be given: less is a moment that passes."""


@dataclass(frozen=True)
class Machine:
    """What a process gets of it.

    Attributes:
        speed: Of a processor, over that on which the work was measured.
        alone: Processors that one thread is given, at most 1.
        together: Processors that as many processes are given as a command starts, in all.
    """

    speed: float
    alone: float
    together: float

    def seconds(self, alone: float, shared: float = 0.0) -> float:
        """How long work takes that needs so many processor seconds, in one thread and shared out."""
        return (alone / self.alone + shared / self.together) / self.speed


@cache
def measured(processes: int) -> Machine:
    """This machine, now, for a command of so many processes."""
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
    """Processor time a second that so many busy threads get together."""
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
    """Processes and threads that run or could, with those of this one; 0 where the system does not say."""
    try:
        with open("/proc/loadavg") as file:
            return int(file.read().split()[3].partition("/")[0])
    except (OSError, ValueError, IndexError):
        return 0


def _work(until: float) -> None:
    while time.perf_counter() < until:
        hashlib.sha256(BLOCK).digest()
