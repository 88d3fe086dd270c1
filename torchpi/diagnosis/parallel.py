"""Independent fits, here or in any executor of `concurrent.futures`."""

import pickle
from collections.abc import Sequence
from concurrent.futures import Executor

import numpy as np
import torch

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.fit import fit
from torchpi.diagnosis.hypothesis import Fit, Hypothesis

Job = tuple[Hypothesis, np.ndarray | None, int, float]
"""What is fitted, from which weights, in how many steps at most, and to which tolerance."""


def fit_all(chain: Chain, jobs: Sequence[Job], executor: Executor | None) -> list[Fit]:
    """The fits of these jobs, in their order; the same numbers wherever they ran."""
    if executor is None:
        return [fit(chain, *job) for job in jobs]
    key, packed = chain.packed
    return list(executor.map(_elsewhere, [key] * len(jobs), [packed] * len(jobs), jobs))


_chains: dict[str, Chain] = {}


def _elsewhere(key: str, packed: bytes, job: Job) -> Fit:
    """A job in a worker, which keeps the recordings that it saw last."""
    if key not in _chains:
        torch.set_num_threads(1)
        _chains.clear()
        _chains[key] = Chain(pickle.loads(packed))
    return fit(_chains[key], *job)
