"""Every test runs in float64 on one thread, and leaves torch's global state as it was."""

import os
from collections.abc import Iterator

# Libraries of linear algebra read it once, as they are imported. With more, threads wait for each other by
# turning in circles: on two busy cores a diagnosis takes five times as long.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import hypothesis  # noqa: E402
import pytest  # noqa: E402
import torch  # noqa: E402

hypothesis.settings.register_profile("torchpi", deadline=None, max_examples=25, derandomize=True)
hypothesis.settings.load_profile("torchpi")


@pytest.fixture(autouse=True)
def untouched_torch() -> Iterator[None]:
    torch.set_num_threads(1)
    before = torch.get_default_dtype(), torch.are_deterministic_algorithms_enabled()
    torch.manual_seed(0)
    yield
    assert (torch.get_default_dtype(), torch.are_deterministic_algorithms_enabled()) == before
