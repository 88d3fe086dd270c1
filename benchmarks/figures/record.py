"""docs/figures.json: each figure's value, bound, command, commit, date, and the machine in words."""

import hashlib
import json
import os
import platform
import subprocess
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from benchmarks.figures.figure import Figure, Measurement
from benchmarks.figures.pages import ROOT
from torchpi.files import write_atomically

RECORD = ROOT / "docs" / "figures.json"
CODE = (
    "torchpi",
    "train",
    "configs",
    "benchmarks",
    "tests/diagnosis/simulations.py",
    "tests/diagnosis/plants.py",
)
"""The files that figures depend on. A commit of others, such as the record, does not invalidate figures."""
BOOKKEEPING = tuple(
    f"benchmarks/figures/{name}.py"
    for name in ("__main__", "child", "command", "figure", "pages", "record", "registry", "table")
)
NOT_CODE = (".md", ".png", *BOOKKEEPING)

Record = dict[str, dict[str, Any]]  # by the name of the figure


def read(path: Path = RECORD) -> Record:
    """Read the recorded measurements; empty if there is no file."""
    if not path.is_file():
        return {}
    found: Record = json.loads(path.read_text(encoding="utf-8"))["figures"]
    return found


def write(record: Record, path: Path = RECORD) -> None:
    """Replace the file in one step, sorted by name."""
    content = {"version": 1, "figures": dict(sorted(record.items()))}
    with write_atomically(path) as temporary:
        temporary.write_text(
            json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n", "utf-8"
        )


def values(record: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    return {name: entry["value"] for name, entry in record.items()}


def registered(found: Record, figures: Mapping[str, Figure]) -> Record:
    """Return only the entries of these figures, with their current bounds."""
    return {
        name: entry | {"bound": [figures[name].at_least, figures[name].at_most]}
        for name, entry in found.items()
        if name in figures
    }


def entries(measurement: Measurement, found: Mapping[str, float], code: str) -> Record:
    """Return the record entries of a measurement that was made just now."""
    about = {
        "command": measurement.command,
        "commit": commit(),
        "code_sha256": code,
        "date": datetime.now(UTC).date().isoformat(),
        "machine": machine(),
    }
    return {
        figure.name: {
            "value": float(f"{found[figure.name]:.6g}"),
            "unit": figure.unit,
            "bound": [figure.at_least, figure.at_most],
            **about,
        }
        for figure in measurement.figures
    }


def code_sha256() -> str:
    """Hash of the code as it lies in the checkout, committed or not."""
    digest = hashlib.sha256()
    for name in sorted(git("ls-files", "-co", "--exclude-standard", "--", *CODE).splitlines()):
        if not name.endswith(NOT_CODE) and (ROOT / name).is_file():
            digest.update(f"{name}\n".encode() + (ROOT / name).read_bytes())
    return digest.hexdigest()[:16]


def commit() -> str:
    """Return the commit, with a note if the code differs from it."""
    status = git("status", "--porcelain", "--", *CODE).splitlines()
    changed = any(not line.endswith(NOT_CODE) for line in status)
    return git("rev-parse", "--short", "HEAD") + (" and changes" if changed else "")


def git(*words: str) -> str:
    """Return what git prints in the checkout.

    Raises:
        ChildProcessError: This is not a git checkout, or git is missing.
    """
    try:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    except (FileNotFoundError, subprocess.CalledProcessError) as error:
        raise ChildProcessError(f"git {words[0]}: found {error}, expected a git checkout") from None
    return done.stdout.strip()


def machine() -> str:
    """Describe the processor and versions in words, without a host name."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    packages = ", ".join(f"{name} {version(name)}" for name in ("torch", "numba", "numpy"))
    python = f"Python {platform.python_version()}"
    return f"{cores} cores of {_processor()}, {platform.system()}, {python}, {packages}"


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines: Iterable[str] = info.read_text(encoding="utf-8").splitlines() if info.is_file() else ()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())
