"""A diagnosis gives the same answer to the last bit whether its fits run here, in threads or in a cluster."""

from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from typing import Any

import numpy as np
import pytest
import torch

from tests.diagnosis.plants import pair, resonance
from torchpi.diagnosis.diagnose import diagnose
from torchpi.diagnosis.diagnosis import Diagnosis
from torchpi.diagnosis.hysteresis_model import preisach
from torchpi.recordings.recording import Recording
from torchpi.stage.effects.effect import DataRange


@pytest.fixture(scope="module")
def here() -> tuple[list[Recording], Diagnosis]:
    torch.set_num_threads(1)
    recordings = pair(1500, after=lambda x, fs_hz: resonance(x, fs_hz, 310.0, 0.03))
    return recordings, diagnose(recordings)


def same(here: tuple[list[Recording], Diagnosis], executor: Executor) -> None:
    recordings, one = here
    other = diagnose(recordings, executor=executor)
    assert [effect.name for effect in one.effects] == ["resonance"]
    assert other.says == one.says and other.effects == one.effects
    for mine, theirs in zip(one.traces, other.traces, strict=True):
        assert np.array_equal(mine.residual_augmented, theirs.residual_augmented)


def test_threads_give_the_same_answer(here: tuple[list[Recording], Diagnosis]) -> None:
    with ThreadPoolExecutor(2) as executor:
        same(here, executor)


class TakesNothingThatChanges(Executor):
    """Runs calls at once, and refuses arguments that another thread could change before they are pickled."""

    calls = 0

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        assert not kwargs and all(isinstance(one, str | bytes) or callable(one) for one in args)
        self.calls += 1
        done: Future[Any] = Future()
        done.set_result(fn(*args))
        return done


def test_jobs_are_pickled_before_they_are_submitted(here: tuple[list[Recording], Diagnosis]) -> None:
    """A pool pickles in a thread of its own; an object that this thread changes meanwhile made it fail."""
    executor = TakesNothingThatChanges()
    same(here, executor)
    assert executor.calls > 10


def structure() -> tuple[object, ...]:
    return preisach(DataRange(1000.0, 1.0, -1.0, 1.0, 10.0, -1.0, 1.0, {})).structure


def test_a_key_made_in_a_worker_equals_the_one_made_here() -> None:
    """Python's own hash differs from process to process: sensitivities to start from were not found again."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        assert pool.submit(structure).result() == structure()


def test_a_dask_client_gives_the_same_answer(here: tuple[list[Recording], Diagnosis]) -> None:
    distributed = pytest.importorskip("distributed", reason="dask's scheduler is not installed")
    with (
        distributed.Client(
            processes=False, n_workers=1, threads_per_worker=2, dashboard_address=None, set_as_default=False
        ) as client,
        client.get_executor() as executor,
    ):
        same(here, executor)
