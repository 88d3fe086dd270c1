"""Independent fits and screens, here or in any executor of `concurrent.futures`."""

import pickle
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from itertools import zip_longest
from typing import Any, TypeVar

import numpy as np
import torch

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.fit import fit
from torchpi.diagnosis.hypothesis import EffectTerm, Fit, Hypothesis
from torchpi.diagnosis.memory import return_memory
from torchpi.diagnosis.score import Weighting
from torchpi.diagnosis.screen import Candidate, Screen
from torchpi.diagnosis.sensitivity import Near

T = TypeVar("T")
PIECES = 2
"""Number of pieces into which a screen is divided; each piece has to prepare the whole tangent space."""
TOGETHER = 16
"""Members that are projected off the tangent space together, so that it is read only once for them."""

Job = tuple[Hypothesis, np.ndarray | None, int, float]
"""The hypothesis to fit, its initial weights, the maximum number of steps, and the tolerance."""


def fit_all(
    chain: Chain, jobs: Sequence[Job], executor: Executor | None, near: Near | None = None
) -> list[Fit]:
    """Return the fits of these jobs, in their order; the numbers do not depend on where they ran."""
    return shared_out(chain, executor, _fit, [(job, near) for job in jobs])


def shared_out(
    chain: Chain, executor: Executor | None, function: Callable[..., T], calls: Sequence[tuple[Any, ...]]
) -> list[T]:
    """Divide calls between an executor and this process, and return the results in the order of the calls.

    Args:
        chain: The recordings, the first argument of each call.
        executor: Takes the calls from the first on; this process takes the last one, then those that no
            worker has begun. None leaves all to this process.
        function: What is called, importable by its name.
        calls: The other arguments of each call.
    """
    if executor is None:
        return [function(chain, *call) for call in calls]
    key, packed = chain.packed
    # Pickled in this thread: a pool pickles in its own, while this one adds cached properties to the objects.
    futures = [
        executor.submit(_elsewhere, function, key, packed, pickle.dumps((chain.weighting, *call)))
        for call in calls[:-1]
    ]
    found = {len(calls) - 1: function(chain, *calls[-1])} if calls else {}
    for k in reversed(range(len(futures))):
        if futures[k].cancel():
            found[k] = function(chain, *calls[k])
    return [found[k] if k in found else futures[k].result() for k in range(len(calls))]


def screen_all(
    chain: Chain, screens: Sequence[tuple[Fit, Sequence[EffectTerm]]], executor: Executor | None
) -> list[list[Candidate]]:
    """Return, for each fit, the candidates that these members give when added to it, in their order."""
    pieces = []
    for now, members in screens:
        groups = [members[k : k + TOGETHER] for k in range(0, len(members), TOGETHER)]
        pieces += [(now, groups[k::PIECES]) for k in range(PIECES)] if executor else [(now, groups)]
    found = shared_out(chain, executor, _candidates, pieces)
    if executor is None:
        return [[candidate for group in one for candidate in group] for one in found]
    together = []
    for first in range(0, len(found), PIECES):
        dealt = zip_longest(*found[first : first + PIECES], fillvalue=[])
        together.append([candidate for groups in dealt for group in groups for candidate in group])
    return together


def get_ready() -> None:
    """Do nothing: a worker that has run this has imported what it needs."""


class _Kept(threading.local):
    """The recordings that a worker saw last; each thread has its own, because cached effects carry state."""

    key = ""
    chain: Chain | None = None


_kept = _Kept()


def _elsewhere(function: Callable[..., T], key: str, packed: bytes, call: bytes) -> T:
    weighting, *arguments = pickle.loads(call)
    return function(_chain(key, packed, weighting), *arguments)


def _fit(chain: Chain, job: Job, near: Near | None) -> Fit:
    found = fit(chain, *job, near)
    return_memory()
    return found


def _candidates(chain: Chain, now: Fit, groups: Sequence[Sequence[EffectTerm]]) -> list[list[Candidate]]:
    screen = Screen(chain, now) if groups else None
    found = [screen.candidates(members) for members in groups] if screen else []
    del screen
    return_memory()
    return found


def _chain(key: str, packed: bytes, weighting: Weighting) -> Chain:
    """Return the chain of the recordings in a worker, which keeps the one that it used last."""
    if _kept.chain is None or _kept.key != key:
        torch.set_num_threads(1)
        _kept.key, _kept.chain = key, Chain(pickle.loads(packed), weighting)
    _kept.chain.weighting = weighting
    return _kept.chain
