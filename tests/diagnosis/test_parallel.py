"""A diagnosis gives the same answer to the last bit whether its fits run here, in threads or in a cluster."""

from concurrent.futures import Executor, ThreadPoolExecutor

import numpy as np
import pytest
import torch

from tests.diagnosis.plants import pair, resonance
from torchpi.diagnosis.diagnose import diagnose
from torchpi.diagnosis.diagnosis import Diagnosis
from torchpi.recordings.recording import Recording


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


def test_a_dask_client_gives_the_same_answer(here: tuple[list[Recording], Diagnosis]) -> None:
    distributed = pytest.importorskip("distributed", reason="dask's scheduler is not installed")
    with (
        distributed.Client(
            processes=False, n_workers=1, threads_per_worker=2, dashboard_address=None, set_as_default=False
        ) as client,
        client.get_executor() as executor,
    ):
        same(here, executor)
