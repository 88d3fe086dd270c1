"""Provenance: enough information to repeat a run and to check that it is the same."""

import hashlib
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Provenance:
    """Command, seed, files with their SHA-256, versions, machine."""

    command: str
    seed: int | None
    files: Mapping[str, str]  # 'what it is: path', or only the path -> SHA-256
    versions: Mapping[str, str]
    machine: str

    def as_json(self) -> dict[str, Any]:
        """Return the content as plain values for JSON."""
        return {
            "command": self.command,
            "seed": self.seed,
            "files_sha256": dict(self.files),
            "versions": dict(self.versions),
            "machine": self.machine,
        }


def provenance(command: str, files: Mapping[str, str | Path], seed: int | None = None) -> Provenance:
    """Gather the provenance of a run.

    Args:
        command: command as typed.
        files: paths by role, e.g. {'compensator': 'exports/demo.pt'}.
        seed: seed of everything random in the run.
    """
    return Provenance(
        command=command,
        seed=seed,
        files={
            f"{role}: {path}": hashlib.sha256(Path(path).read_bytes()).hexdigest()
            for role, path in files.items()
        },
        versions={"python": platform.python_version(), **_versions("torchpi", "torch", "numpy", "numba")},
        machine=f"{platform.system()} {platform.machine()}",
    )


def _versions(*packages: str) -> dict[str, str]:
    found = {}
    for package in packages:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed as a package"
    return found
