"""Every test runs in float64 on one thread, and leaves torch's global state as it was."""

from collections.abc import Iterator

import hypothesis
import pytest
import torch

hypothesis.settings.register_profile("torchpi", deadline=None, max_examples=25, derandomize=True)
hypothesis.settings.load_profile("torchpi")


@pytest.fixture(autouse=True)
def untouched_torch() -> Iterator[None]:
    torch.set_num_threads(1)
    before = torch.get_default_dtype(), torch.are_deterministic_algorithms_enabled()
    torch.manual_seed(0)
    yield
    assert (torch.get_default_dtype(), torch.are_deterministic_algorithms_enabled()) == before
