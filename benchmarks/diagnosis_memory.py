"""Measure the time and the memory of `torchpi diagnose` against the number of samples.

    python benchmarks/diagnosis_memory.py [--samples 99000 3000000]

Three recordings of the built-in stage, compared with the plain stage. Memory is the proportional set size of
the command and its workers together, read from /proc four times a second: shared pages count once.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from torchpi.stage import Stage

RECORDINGS, RATE_HZ = 3, 10_000.0


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--samples", type=int, nargs="+", default=[99_000, 3_000_000])
    options = parser.parse_args()
    print("  samples   time s   memory GB")
    for samples in options.samples:
        seconds, peak_gb = _measured(samples)
        print(f"{samples:9,}  {seconds:7.1f}  {peak_gb:10.2f}", flush=True)


def _measured(samples: int) -> tuple[float, float]:
    with tempfile.TemporaryDirectory() as folder:
        files = _recorded(samples // RECORDINGS, Path(folder))
        command = [sys.executable, "-m", "torchpi", "diagnose", *files, "--output", f"{folder}/page"]
        begun, peak_kb, said = time.monotonic(), 0, Path(folder) / "said.txt"
        with said.open("w") as log, subprocess.Popen(command, stdout=log, stderr=log) as process:
            while process.poll() is None:
                peak_kb = max(peak_kb, sum(_proportional_kb(one) for one in _family(process.pid)))
                time.sleep(0.25)
        if process.returncode:
            raise SystemExit(f"torchpi diagnose: exit code {process.returncode}\n{said.read_text()}")
        return time.monotonic() - begun, peak_kb / 1e6


def _recorded(samples: int, folder: Path) -> list[str]:
    stage, files = Stage.load("default"), []
    t = np.arange(samples) / RATE_HZ
    for k in range(RECORDINGS):
        rng = np.random.default_rng(k)
        tones = [np.sin(2 * np.pi * (hz * t + rng.uniform())) for hz in rng.uniform(0.5, 40.0, 8)]
        u = 5.0 + 4.0 * np.sum(tones, axis=0) / np.abs(np.sum(tones, axis=0)).max()
        u *= np.minimum(1.0, 4 * t / t[-1])
        _, reading = stage.simulate(u[None], seed=k)
        path = folder / f"{k}.npz"
        np.savez(path, time_s=t, input_v=u, output_um=np.asarray(reading)[0])
        files.append(str(path))
    return files


def _family(pid: int) -> list[int]:
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return []
    return [pid, *(each for child in children for each in _family(int(child)))]


def _proportional_kb(pid: int) -> int:
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith("Pss:")), 0)


if __name__ == "__main__":
    main()
