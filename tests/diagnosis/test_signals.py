"""A diagnosis that is interrupted or killed leaves no process behind."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.hostile.kills import alive, descendants
from torchpi.recordings.recording import Recording, write_recording

ROOT = Path(__file__).parents[2]
MOST_S = 2.0

pytestmark = [
    pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="children are found in /proc"),
    pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="one core: no workers"),
]


@pytest.fixture
def diagnosis(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """`torchpi diagnose` with its workers started."""
    t = np.arange(20_000) / 2e3
    u = 5 - 5 * np.cos(2 * np.pi * (1 + 2 * t) * t)
    y = 0.8 * u + 0.1 * np.sin(u) + np.random.default_rng(0).normal(0, 0.01, len(t))
    write_recording(tmp_path / "a.csv", Recording("a", t, u, y, 2e3))
    command = [sys.executable, "-m", "torchpi", "diagnose", str(tmp_path / "a.csv")]
    process = subprocess.Popen(
        [*command, "--output", str(tmp_path / "diagnosis")],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    end = time.monotonic() + 60
    # The resource tracker and at least one worker.
    while len(descendants(process.pid)) < 2 and process.poll() is None and time.monotonic() < end:
        time.sleep(0.05)
    yield process
    process.kill()
    process.communicate()


@pytest.mark.parametrize(
    ("number", "after_s", "code", "word"),
    [
        (signal.SIGTERM, 4.0, 143, "terminated"),
        (signal.SIGINT, 0.0, 130, "interrupted"),
        (signal.SIGKILL, 0.0, -9, ""),
        (signal.SIGKILL, 4.0, -9, ""),
    ],
)
def test_a_terminated_diagnosis_leaves_no_process(
    number: signal.Signals, after_s: float, code: int, word: str, diagnosis: subprocess.Popen[str]
) -> None:
    time.sleep(after_s)
    children = descendants(diagnosis.pid)
    assert len(children) >= 2
    sent = time.monotonic()
    diagnosis.send_signal(number)
    while any(map(alive, children)) and time.monotonic() < sent + MOST_S:
        time.sleep(0.02)
    assert not any(map(alive, children))
    diagnosis.wait(5 * MOST_S)
    error = diagnosis.stderr.read() if diagnosis.stderr else ""
    assert diagnosis.returncode == code
    if number == signal.SIGKILL and not after_s:
        return  # Python itself reports a worker whose parent died while it was being started
    assert error == (f"torchpi: {word}; files already written are complete\n" if word else "")
