"""A killed command leaves previous files intact and no process running, and the next run succeeds.

`benchmarks/kills.py` kills more commands at more moments.
"""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.hostile.kills import ROOT, SIGNALS, alive, commands, descendants, kill_often


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="children are found in /proc")
def test_a_killed_command_leaves_complete_files_and_the_next_run_succeeds(tmp_path: Path) -> None:
    outcome = kill_often(commands(tmp_path)["export"], rounds=1, finish_every=len(SIGNALS))
    assert outcome.faults == [] and sum(outcome.kills.values()) > 0


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="children are found in /proc")
@pytest.mark.parametrize("one", [signal.SIGTERM, signal.SIGKILL])  # a shell's background job ignores SIGINT
def test_processes_started_by_a_measurement_end_with_it(one: signal.Signals, tmp_path: Path) -> None:
    file = tmp_path / "endless.py"
    file.write_text("import time\nprint(__file__, flush=True)\ntime.sleep(600)\n", encoding="utf-8")
    words = (
        f"sys.executable, '-m', 'benchmarks.figures.child', str(os.getpid()), '{os.path.relpath(file, ROOT)}'"
    )
    program = [sys.executable, "-c", f"import os, subprocess, sys\nsubprocess.run([{words}])"]
    with subprocess.Popen(program, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdout is not None and process.stdout.readline() == f"{file}\n".encode()  # it runs
        children = descendants(process.pid)
        process.send_signal(one)
    gone_by = time.monotonic() + 10.0
    while any(map(alive, children)) and time.monotonic() < gone_by:
        time.sleep(0.02)
    assert children and not any(map(alive, children))
