"""Worker processes that end with the process that started them, however it ended.

Nothing heavy is imported here: a worker has to watch its parent before it spends seconds on importing torch.
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
"""What libraries of linear algebra read, once, as they are imported."""
WATCH_S = 0.2
LEFT_SEMAPHORES = "ignore::UserWarning:multiprocessing.resource_tracker"


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def worker_pool(get_ready: Callable[[], object]) -> Iterator[Executor | None]:
    """Processes for all cores but the one that this process has, or None where there is only one.

    An error in the block, an interrupt above all, kills them at once.

    Args:
        get_ready: Called in each worker while the block has begun, so that it imports what it will need.
    """
    workers = min(available_cores() - 1, MOST_WORKERS)
    if workers == 0:
        yield None
        return
    # Spawned, because a forked process would inherit the threads of torch in an unknown state.
    with _one_thread_each(), _quiet_tracker():
        pool = ProcessPoolExecutor(workers, get_context("spawn"), end_with_parent, (os.getpid(),))
        try:
            with _signals_after():  # between its start and its entry in the pool nobody could end a worker
                for _ in range(workers):
                    pool.submit(get_ready)
            yield pool
        except BaseException:
            _kill(pool)
            raise
        pool.shutdown()


def _kill(pool: ProcessPoolExecutor) -> None:
    """Kill the workers; the pool, broken, then gives up what is pending."""
    for process in list((pool._processes or {}).values()):
        process.kill()
    # What is on its way to the workers has no reader any more, and would be waited for at exit.
    if (queue := getattr(pool, "_call_queue", None)) is not None:
        queue.cancel_join_thread()
    pool.shutdown(wait=False)


def end_with_parent(parent: int) -> None:
    """In a worker: leave an interrupt to the parent, and end when the parent is gone.

    Args:
        parent: Its process id.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _signals_after() -> Iterator[None]:
    """Interrupts and terminations wait for the end of the block."""
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
    """Python's tracker of semaphores, if it starts meanwhile, will not warn of those that this process leaves
    when it is killed: it removes them."""
    sys.warnoptions.append(LEFT_SEMAPHORES)  # inherited by what starts
    try:
        yield
    finally:
        sys.warnoptions.remove(LEFT_SEMAPHORES)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes that start meanwhile multiply matrices in one thread: as many as cores for each of as many
    processes take three times as long."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value
