"""How kernels over NumPy arrays are compiled, and how their tasks are spread over threads."""

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from torch import Tensor

try:
    import numba
except ImportError:  # plays and their weighted sums then run in plain torch
    HAS_COMPILER = False
else:
    HAS_COMPILER = True


def njit(function: Callable[..., Any]) -> Any:
    """Compile for speed that changes no bit: no fast mathematics, no fused multiply-add.

    Without Numba the function comes back as it is.
    """
    if not HAS_COMPILER:
        return function
    return numba.njit(function, cache=True, nogil=True, error_model="numpy")


def njit_sum(function: Callable[..., Any]) -> Any:
    """`njit` for a sum whose order is the compiler's to choose, as many beside each other as it likes.

    For gradients alone: the order is one for all inputs and threads, yet not on every machine.
    """
    if not HAS_COMPILER:
        return function
    return numba.njit(function, cache=True, nogil=True, error_model="numpy", fastmath={"reassoc"})


def in_threads(kernel: Callable[..., None], tasks: int, *arguments: object) -> None:
    """Call `kernel(first, last, *arguments)` for ranges that together are all tasks.

    As many ranges as torch may use threads. They are plain Python threads, since compiled kernels let
    go of the interpreter: no threading layer to clash with torch's own, and safe in DDP processes, in
    data loader workers and after a fork.
    """
    threads = min(torch.get_num_threads(), tasks)
    if threads <= 1:
        kernel(0, tasks, *arguments)
        return
    edges = [tasks * k // threads for k in range(threads + 1)]
    ranges = list(itertools.pairwise(edges))
    others = [_pool(threads).submit(kernel, first, last, *arguments) for first, last in ranges[1:]]
    kernel(*ranges[0], *arguments)
    for other in others:
        other.result()


def as_array(tensor: Tensor) -> np.ndarray:
    """The tensor as kernels take it: its own memory where that is contiguous, else a copy."""
    return tensor.detach().contiguous().numpy()


_pools: dict[int, ThreadPoolExecutor] = {}


def _pool(threads: int) -> ThreadPoolExecutor:
    if threads not in _pools:
        _pools[threads] = ThreadPoolExecutor(threads - 1, "torchpi")
    return _pools[threads]


# A forked child has none of its parent's threads.
os.register_at_fork(after_in_child=_pools.clear)
