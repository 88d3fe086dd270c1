"""Worker processes that end with the process that started them, however that process ends.

Nothing heavy is imported here, because a worker must watch its parent before it spends seconds on torch.
"""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context

MOST_WORKERS = 3
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables that linear-algebra libraries read once, when they are imported."""
WATCH_S = 0.2
LEFT_SEMAPHORES = "ignore::UserWarning:multiprocessing.resource_tracker"


def available_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def worker_pool(get_ready: Callable[[], object]) -> Iterator[Executor | None]:
    """Start processes for all cores but the one of this process, at most `MOST_WORKERS`; None for one core.

    An error in the block, in particular an interrupt, kills the workers at once.

    Args:
        get_ready: Called in each worker as the block begins, so that the worker imports what it needs.
    """
    workers = min(available_cores() - 1, MOST_WORKERS)
    if workers == 0:
        yield None
        return
    # Spawned, because a forked process would inherit the threads of torch in an unknown state.
    with _one_thread_each(), _quiet_tracker():
        pool = ProcessPoolExecutor(workers, get_context("spawn"), end_with_parent, (os.getpid(),))
        try:
            with _signals_after():  # a worker could not be ended between its start and its entry in the pool
                for _ in range(workers):
                    pool.submit(get_ready)
            yield pool
        except BaseException:
            _kill(pool)
            raise
        pool.shutdown()


def _kill(pool: ProcessPoolExecutor) -> None:
    """Kill the workers; the broken pool then gives up its pending tasks."""
    for process in list((pool._processes or {}).values()):
        process.kill()
    # Data queued for the workers has no reader any more; without this, exit would wait for it.
    if (queue := getattr(pool, "_call_queue", None)) is not None:
        queue.cancel_join_thread()
    pool.shutdown(wait=False)


def end_with_parent(parent: int) -> None:
    """Make a worker leave interrupts to its parent and end when the parent is gone.

    Args:
        parent: Process id of the parent.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _signals_after() -> Iterator[None]:
    """Defer interrupts and terminations to the end of the block."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, lambda number, frame: came.append(number)) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
    if came:
        signal.raise_signal(came[0])


@contextmanager
def _quiet_tracker() -> Iterator[None]:
    """Keep Python's semaphore tracker, if it starts meanwhile, from warning about semaphores that this
    process leaves when killed; the tracker removes them."""
    sys.warnoptions.append(LEFT_SEMAPHORES)  # inherited by processes started meanwhile
    try:
        yield
    finally:
        sys.warnoptions.remove(LEFT_SEMAPHORES)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Limit processes started meanwhile to one thread for linear algebra. As many threads as cores in each of
    as many processes take three times as long."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value
