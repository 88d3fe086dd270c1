"""Every command and every line of Python in the README runs, in an empty folder, from the built wheel.

`benchmarks/wheel_readme.py` runs them in an environment that has nothing but the wheel and what it requires.
"""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.shared import made_once

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
TUTORIAL = (ROOT / "docs" / "mismatch.md").read_text(encoding="utf-8")  # its Python is run too
FROM_WHEEL = "import torchpi, warnings; assert {!r} in torchpi.__file__; warnings.simplefilter('ignore')"


PARTS = {
    "diagnose": ("torchpi diagnose", "torchpi predict", "--config through_stage", "predicted.csv"),
    "train": ("--config recorded", "torchpi export", "torchpi run", "exports/mine.pt"),
    "commission": ("torchpi check", "torchpi commission"),
    "reproduce": ("torchpi excite", "torchpi reproduce", "recordings/slow.csv"),
}
"""Texts that identify the commands and programs of each part; parts share only the recordings."""


def blocks(language: str, page: str = README) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page, re.DOTALL)


def commands() -> list[str]:
    return [line for block in blocks("sh") for line in block.splitlines() if not line.startswith("make ")]


def programs() -> list[str]:
    return [*blocks("python"), *blocks("python", TUTORIAL)]


def part_of(text: str) -> str:
    """Return the first part of which an identifying text occurs."""
    return next(part for part, marks in PARTS.items() if any(mark in text for mark in marks))


@pytest.fixture(scope="session")
def recordings(installed: Path) -> Path:
    """Return a folder with the recordings that the README simulates."""

    def simulate(folder: Path) -> None:
        for command in commands():
            if command.startswith("torchpi simulate"):
                run(shlex.split(command), folder, installed)

    return made_once("readme", simulate) / "recordings"


def run(command: list[str], folder: Path, installed: Path) -> None:
    environment = {
        **os.environ,
        "PATH": os.pathsep.join([str(installed / "bin"), os.environ["PATH"]]),
        "PYTHONPATH": str(installed),
    }
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, f"{shlex.join(command)}\n{done.stdout}\n{done.stderr}"


@pytest.mark.long
@pytest.mark.parametrize("part", PARTS)
def test_commands_and_python_run_in_order_from_the_wheel(
    part: str, recordings: Path, installed: Path, tmp_path: Path
) -> None:
    shutil.copytree(recordings, tmp_path / "recordings")
    mine = [shlex.split(one) for one in commands() if "torchpi simulate" not in one and part_of(one) == part]
    assert len(mine) >= 2
    for command in mine:
        run(command, tmp_path, installed)
    for program in programs():
        if part_of(program) == part:
            run(
                [sys.executable, "-c", f"{FROM_WHEEL.format(str(installed))}\n{program}"], tmp_path, installed
            )
    if part == "diagnose":
        diagnosis = json.loads((tmp_path / "diagnosis" / "diagnosis.json").read_text(encoding="utf-8"))
        names = {effect["name"] for effect in diagnosis["effects"]}
        assert diagnosis["verdict"] == "explained"
        assert names & {"amplifier_lag", "sensor_lag", "delay"}
        found = {
            (effect["name"], name): one["value"]
            for effect in diagnosis["effects"]
            for name, one in effect["parameters"].items()
        }
        # Values in the stage's file.
        assert found["resonance", "frequency_hz"] == pytest.approx(620, rel=0.01)
        assert found["creep", "per_decade"] == pytest.approx(0.015, rel=0.05)
        assert found["input_nonlinearity", "c2_per_v"] == pytest.approx(0.02, rel=0.1)
    if part == "train":
        assert (tmp_path / "runs" / "mine" / "report.html").is_file()
        assert (tmp_path / "exports" / "mine" / "loop.html").is_file()


def test_readme_make_targets_exist() -> None:
    targets = [line.split()[1] for block in blocks("sh") for line in block.splitlines() if "make " in line]
    assert targets == ["demo", "test"]
    for target in targets:
        assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)


def test_readme_cpp_calls_appear_in_the_example_that_is_built() -> None:
    example = (ROOT / "exports" / "cpp_loop" / "main.cpp").read_text(encoding="utf-8")
    for line in "".join(blocks("cpp")).splitlines():
        call = re.sub(r"\(.*", "(", line.split("=", 1)[1].strip())
        assert call in example, line


def test_readme_names_files_that_exist() -> None:
    for path in re.findall(r"\]\(([\w./]+)\)", README):
        assert (ROOT / path).exists(), path
    for path in re.findall(r"^\| `([\w./]+/?)`", README, re.MULTILINE):
        assert (ROOT / path).exists(), path
