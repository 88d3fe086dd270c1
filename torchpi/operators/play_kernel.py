"""The compiled play bank: states of all plays over whole records, and the exact adjoint.

Threads divide records and plays among them in the forward pass, records and stretches in the backward pass.
"""

import numpy as np
import torch

from torchpi.operators.compiled import in_threads, njit
from torchpi.operators.folded import hand_over
from torchpi.operators.play_equation import play

_play = njit(play)


def play_bank_forward(x: np.ndarray, r: np.ndarray, h0: np.ndarray, h: np.ndarray) -> None:
    """Fill `h`, (batch, time, plays)."""
    # Blocks of few plays would share the cache lines that they write, and every block walks over all pages:
    # only as many blocks as occupy the threads that the records leave without work.
    blocks = max(min(torch.get_num_threads() // len(x), len(r) // 32), 1)
    in_threads(_forward, len(x) * blocks, x, r, h0, blocks, h)


def play_bank_backward(
    x: np.ndarray, r: np.ndarray, h0: np.ndarray, h: np.ndarray, gh: np.ndarray, gx: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Fill `gx` from the gradient `gh` of the states; return the gradients of `r` and of `h0`."""
    batch, samples = x.shape
    # The cut depends on the shape alone, so that sums have the same order for any number of threads.
    stretches, length = _cut(samples, len(r))
    left = np.zeros((batch, stretches, len(r), 1), x.dtype)
    latest = np.zeros((batch, stretches, len(r), 1), np.int64)
    gr = np.zeros((batch, stretches, len(r)), x.dtype)
    in_threads(_backward, batch * stretches, x, r, h0, h, length, gh, gx, gr, left, latest)
    gh0 = np.zeros_like(h0)
    hand_over(left, latest, length, gx, gr[:, 0], gh0)
    return gr.sum((0, 1)), gh0


def _cut(samples: int, plays: int) -> tuple[int, int]:
    """Return the number of stretches of a record, and the samples per stretch."""
    count = min(max(samples * plays // 2**17, 1), 64, samples)
    length = -(-samples // count)
    return -(-samples // length), length


@njit
def _forward(
    first: int, last: int, x: np.ndarray, r: np.ndarray, h0: np.ndarray, blocks: int, h: np.ndarray
) -> None:
    for task in range(first, last):
        row, block = divmod(task, blocks)
        begin, end = len(r) * block // blocks, len(r) * (block + 1) // blocks
        state = h0[row].copy()
        for t in range(x.shape[1]):
            for i in range(begin, end):
                state[i] = _play(x[row, t], r[i], state[i])
                h[row, t, i] = state[i]


@njit
def _backward(
    first: int, last: int, x: np.ndarray, r: np.ndarray, h0: np.ndarray, h: np.ndarray, length: int,
    gh: np.ndarray, gx: np.ndarray, gr: np.ndarray, left: np.ndarray, latest: np.ndarray,
) -> None:  # fmt: skip
    # Every state is x_s - r or x_s + r of the last sample s that pushed it, or h0: the gradient waits
    # in `carried` while the play rests, and is added at the sample that pushed.
    rests = x.dtype.type(0)
    carried, landed, gr_here = np.empty_like(r), np.empty_like(r), np.empty_like(r)
    for task in range(first, last):
        row, stretch = divmod(task, left.shape[1])
        carried[:] = 0
        gr_here[:] = 0
        unknown = len(r)
        begin = stretch * length
        for t in range(min(begin + length, x.shape[1]) - 1, begin - 1, -1):
            sample = x[row, t]
            before = h[row, t - 1] if t > 0 else h0[row]
            for i in range(len(r)):
                gradient = carried[i] + gh[row, t, i]
                above = gradient if before[i] > sample - r[i] else rests
                carried[i] = above if before[i] < sample + r[i] else rests
                landed[i] = gradient - carried[i]
                gr_here[i] += landed[i] if before[i] > sample else -landed[i]
            total = rests
            for i in range(len(r)):
                total += landed[i]
            gx[row, t] = total
            if unknown > 0:
                unknown = 0
                for i in range(len(r)):
                    if latest[row, stretch, i, 0] == 0:
                        if before[i] <= sample - r[i]:
                            latest[row, stretch, i, 0] = -(t - begin + 1)
                        elif before[i] >= sample + r[i]:
                            latest[row, stretch, i, 0] = t - begin + 1
                        else:
                            unknown += 1
        left[row, stretch, :, 0] = carried
        gr[row, stretch] = gr_here
