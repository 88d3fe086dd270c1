"""Compilation of kernels over NumPy arrays, and distribution of their tasks over threads."""

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
    """Compile with Numba without changing any bit: no fast mathematics, no fused multiply-add.

    Without Numba, return the function unchanged.
    """
    if not HAS_COMPILER:
        return function
    return numba.njit(function, cache=True, nogil=True, error_model="numpy")


def njit_sum(function: Callable[..., Any]) -> Any:
    """Like `njit`, but the compiler may choose the order of sums, so that it can vectorise them.

    For gradients only: the order is the same for all inputs and threads, but may differ between machines.
    """
    if not HAS_COMPILER:
        return function
    return numba.njit(function, cache=True, nogil=True, error_model="numpy", fastmath={"reassoc"})


def in_threads(kernel: Callable[..., None], tasks: int, *arguments: object) -> None:
    """Call `kernel(first, last, *arguments)` for ranges that together cover all tasks.

    There are as many ranges as torch may use threads. They run in plain Python threads, because compiled
    kernels release the interpreter: there is no threading layer that could clash with torch's own, and
    it is safe in DDP processes, in data loader workers and after a fork.
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
    """Return the tensor as an array for kernels: its own memory if that is contiguous, else a copy."""
    return tensor.detach().contiguous().numpy()


_pools: dict[int, ThreadPoolExecutor] = {}


def _pool(threads: int) -> ThreadPoolExecutor:
    if threads not in _pools:
        _pools[threads] = ThreadPoolExecutor(threads - 1, "torchpi")
    return _pools[threads]


# A forked child has none of its parent's threads.
os.register_at_fork(after_in_child=_pools.clear)
