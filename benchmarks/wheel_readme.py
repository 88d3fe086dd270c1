"""Does an installed torchpi do what the README says? Its commands, in their order, from the built wheel.

    python benchmarks/wheel_readme.py [--keep folder]

Builds the wheel, installs it without its dependencies into a folder of its own, which comes first on the
path, and runs each command of the README in an empty folder. Prints the seconds of each, and ends with 1 at
the first that fails.
"""

import argparse
import os
import re
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--keep", type=Path, help="empty folder in which all is done and left")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = (options.keep or Path(temporary)).resolve()
        site, empty = folder / "site", folder / "empty"
        empty.mkdir(parents=True)
        pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
        subprocess.run(
            [*pip, "wheel", "--no-deps", "--no-build-isolation", "-w", str(folder), str(ROOT)], check=True
        )
        (wheel,) = folder.glob("*.whl")
        subprocess.run([*pip, "install", "--no-deps", "--target", str(site), str(wheel)], check=True)
        path = os.pathsep.join([str(site / "bin"), str(Path(sys.executable).parent), os.environ["PATH"]])
        environment = {**os.environ, "PATH": path, "PYTHONPATH": str(site)}
        for command in commands((ROOT / "README.md").read_text(encoding="utf-8")):
            started = time.perf_counter()
            done = subprocess.run(
                shlex.split(command), cwd=empty, env=environment, capture_output=True, text=True
            )
            print(f"{time.perf_counter() - started:6.1f} s  {command}", flush=True)
            if done.returncode:
                print(done.stdout + done.stderr, file=sys.stderr)
                return 1
    return 0


def commands(readme: str) -> list[str]:
    """The README's lines of shell, without those of `make`, which are of a checkout."""
    blocks = re.findall(r"```sh\n(.*?)```", readme, re.DOTALL)
    return [line for block in blocks for line in block.splitlines() if not line.startswith("make ")]


if __name__ == "__main__":
    sys.exit(main())
