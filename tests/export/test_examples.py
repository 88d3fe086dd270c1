"""The loops in exports/ build, run, and give the voltages of the compensator."""

import math
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from tests.export.c_compiler import needs_cc
from tests.export.test_torchscript import compensator
from torchpi.export import export_files

EXPORTS = Path(__file__).parents[2] / "exports"


def desired_um(tick: int) -> float:
    return 2 - 2 * math.cos(2 * math.pi * 5 * tick * compensator().sample_period_s)


def expected_lines(samples: int) -> list[float]:
    made = compensator()
    stream = made.stream()
    ticks = [made.preview + k for k in range(samples)]
    return [stream.step(2 - 2 * math.cos(2 * math.pi * 5 * k * made.sample_period_s)) for k in ticks]


def voltages(command: list[str]) -> list[float]:
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return [float(line.split()[-2]) for line in printed.splitlines()]


def test_python_loop_runs_without_torchpi_and_gives_the_same_voltages(tmp_path: Path) -> None:
    export_files(compensator(), tmp_path / "c", ["torchscript"])
    command = [sys.executable, "-I", str(EXPORTS / "python_loop" / "loop.py"), str(tmp_path / "c.pt"), "50"]
    assert voltages(command) == expected_lines(50)


@pytest.mark.skipif(
    torch.version.cuda is not None, reason="the CUDA build of torch wants the CUDA toolkit of its own release"
)
@pytest.mark.long
@pytest.mark.skipif(
    not (shutil.which("cmake") and shutil.which("c++")), reason="needs cmake and a C++ compiler"
)
def test_cpp_loop_builds_and_gives_the_same_voltages(tmp_path: Path) -> None:
    export_files(compensator(), tmp_path / "c", ["torchscript"])
    build = tmp_path / "build"
    prefix = torch.utils.cmake_prefix_path
    configure = ["cmake", "-S", str(EXPORTS / "cpp_loop"), "-B", str(build), f"-DCMAKE_PREFIX_PATH={prefix}"]
    subprocess.run(configure, capture_output=True, check=True)
    subprocess.run(["cmake", "--build", str(build)], capture_output=True, check=True)
    assert voltages([str(build / "loop"), str(tmp_path / "c.pt"), "50"]) == expected_lines(50)
    refused = subprocess.run(
        [str(build / "loop"), str(EXPORTS / "README.md")], capture_output=True, text=True
    )
    assert refused.returncode == 2 and refused.stderr.count("\n") == 1


@needs_cc
@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
def test_c_loop_builds_and_gives_the_same_voltages(tmp_path: Path) -> None:
    export_files(compensator(), tmp_path / "demo", ("c",))
    loop = tmp_path / "c_loop"
    shutil.copytree(EXPORTS / "c_loop", loop, ignore=shutil.ignore_patterns("loop", "selftest"))
    strict = "CFLAGS=-std=c99 -ffp-contract=off -O2 -Wall -Wextra -Wpedantic -Werror"
    subprocess.run(["make", "-C", str(loop), strict, "selftest", "loop"], capture_output=True, check=True)
    assert voltages([str(loop / "loop")])[:50] == expected_lines(50)

    # The same motion from a file; it rests after the end of the file.
    rows = [f"{k * 1e-4:.17g},{desired_um(k):.17g}" for k in range(50 + compensator().preview)]
    (tmp_path / "t.csv").write_text("time_s,yd_um\n" + "\n".join(rows) + "\n")
    assert voltages([str(loop / "loop"), str(tmp_path / "t.csv")])[:50] == expected_lines(50)
    for path in (tmp_path / "nowhere.csv", EXPORTS / "README.md"):
        refused = subprocess.run([str(loop / "loop"), str(path)], capture_output=True, text=True)
        assert refused.returncode == 2 and refused.stderr.count("\n") == 1
