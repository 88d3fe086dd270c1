"""The lock file of `make` pins each requirement to a version that the requirement admits."""

import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
LOCKED = [
    Requirement(line)
    for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    if not line.startswith("#")
]
GROUPS = {"core": PROJECT["dependencies"], **PROJECT["optional-dependencies"]}


@pytest.mark.parametrize("group", GROUPS)
def test_every_requirement_but_torch_is_locked_within_its_bounds(group: str) -> None:
    for text in GROUPS[group]:
        required = Requirement(text)
        if required.name in ("torch", "torchpi"):  # the Makefile pins torch
            continue
        found = [one for one in LOCKED if one.name.lower() == required.name.lower()]
        assert found, f"{required.name}: run make lock"
        for one in found:
            (version,) = (pin.version for pin in one.specifier)
            assert required.specifier.contains(version), f"{required} excludes {version}: run make lock"


def test_torch_is_pinned_by_the_makefile_alone() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    version = makefile.partition("TORCH_VERSION := ")[2].partition("\n")[0]
    (torch,) = (one for one in map(Requirement, PROJECT["dependencies"]) if one.name == "torch")
    assert torch.specifier.contains(version)
    assert not [one for one in LOCKED if one.name == "torch" or one.name.startswith(("nvidia-", "cuda-"))]
