"""Long tests run first; each runs in float64 on one thread, and leaves torch's global state as it was."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

# Linear-algebra libraries read these variables once, on import. With more than one thread, threads spin while
# they wait for each other: on two busy cores a diagnosis takes five times as long.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import hypothesis  # noqa: E402
import pytest  # noqa: E402
import torch  # noqa: E402

from tests import shared  # noqa: E402

ROOT = Path(__file__).parents[1]

hypothesis.settings.register_profile("torchpi", deadline=None, max_examples=25, derandomize=True)
hypothesis.settings.load_profile("torchpi")


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):  # workers inherit the folder
        shared.begin()


def pytest_unconfigure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):
        shared.end()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: item.get_closest_marker("long") is None)


@pytest.fixture(autouse=True)
def untouched_torch() -> Iterator[None]:
    torch.set_num_threads(1)
    before = torch.get_default_dtype(), torch.are_deterministic_algorithms_enabled()
    torch.manual_seed(0)
    yield
    assert (torch.get_default_dtype(), torch.are_deterministic_algorithms_enabled()) == before


@pytest.fixture(scope="session")
def wheel() -> Path:
    def build(folder: Path) -> None:
        pip("wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", str(folder), str(ROOT))

    (built,) = shared.made_once("wheel", build).glob("*.whl")
    return built


@pytest.fixture(scope="session")
def installed(wheel: Path) -> Path:
    """Return a folder to import from, in which nothing but the wheel is installed."""

    def install(site: Path) -> None:
        pip("install", "--no-deps", "--no-index", "--no-compile", "--target", str(site), str(wheel))
        share_kernels(ROOT / "torchpi", site / "torchpi")

    return shared.made_once("site", install)


def share_kernels(source: Path, target: Path) -> None:
    """Give a copy of the package the kernels that are compiled for the original, which takes a minute again.
    Numba loads them where a file has the size and the time of modification for which it compiled them."""
    for kernel in source.rglob("__pycache__/*.nb[ci]"):
        place = target / kernel.relative_to(source)
        place.parent.mkdir(exist_ok=True)
        shutil.copyfile(kernel, place)
    for file in source.rglob("*.py"):
        times = file.stat()
        os.utime(target / file.relative_to(source), ns=(times.st_atime_ns, times.st_mtime_ns))


def pip(*arguments: str) -> None:
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet", *arguments]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
