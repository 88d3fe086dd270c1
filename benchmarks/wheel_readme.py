"""Run the README's commands and programs with an installed torchpi in an otherwise empty environment.

    python benchmarks/wheel_readme.py [--keep folder]

Builds the wheel, installs it with only its requirements in a new environment, and there, in an empty folder,
runs each command and each program of the README. It then tries a file of each format that needs an extra: the
error must contain the line that installs it. Prints the seconds that each took, with the command's own
estimate, and exits with 1 at the first failure.
"""

import argparse
import os
import re
import shlex
import subprocess
import sys
import tempfile
import time
import venv
from pathlib import Path

ROOT = Path(__file__).parents[1]
NEED_EXTRAS = {
    "torchpi check a.h5": "pip install 'torchpi[io]'",
    "torchpi check a.tdms": "pip install 'torchpi[io]'",
    "torchpi check a.mf4": "pip install 'torchpi[io]'",
    "torchpi diagnose recordings/slow.csv --simulation a.fmu": "pip install 'torchpi[fmi]'",
}


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--keep", type=Path, help="empty folder in which all is done and left")
    options = parser.parse_args()
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as temporary:
        folder = (options.keep or Path(temporary)).resolve()
        empty, environment = folder / "empty", installed(folder)
        empty.mkdir()
        programs = [["python", "-W", "ignore", "-c", text] for text in blocks(readme, "python")]
        for command in [*commands(readme), *programs]:
            if not runs(command, empty, environment):
                return 1
        for text, line in NEED_EXTRAS.items():
            command = shlex.split(text)
            (empty / next(word for word in command if word.startswith("a."))).write_bytes(b"\x89")
            done = run(command, empty, environment)
            error = done.stderr.rstrip("\n")
            if done.returncode != 2 or "\n" in error or line not in error:
                print(f"{text}: found {error!r}, expected one line with {line}", file=sys.stderr)
                return 1
            print(f"{text}: {error}")
    return 0


def installed(folder: Path) -> dict[str, str]:
    """Install the wheel of this checkout in a new environment and return the variables that select it."""
    pip = ["-m", "pip", "--disable-pip-version-check", "--quiet"]
    build = [*pip, "wheel", "--no-deps", "--wheel-dir", str(folder), str(ROOT)]
    subprocess.run([sys.executable, *build], check=True)
    (wheel,) = folder.glob("*.whl")
    venv.create(folder / "environment", with_pip=True)
    programs = folder / "environment" / "bin"
    subprocess.run([programs / "python", *pip, "install", str(wheel)], check=True)
    path = os.pathsep.join([str(programs), os.environ["PATH"]])
    others = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    return {**others, "PATH": path}


def runs(command: list[str], folder: Path, environment: dict[str, str]) -> bool:
    """Run a command and print its time, its own estimate, and any error; return whether it succeeded."""
    started = time.perf_counter()
    done = run(command, folder, environment)
    seconds = time.perf_counter() - started
    estimate = re.search(r"This will take (.*)\.$", done.stdout, re.MULTILINE)
    words = shlex.join(command).splitlines()[0][:110]
    print(f"{seconds:6.1f} s  {words}{f' ({estimate[1]})' if estimate else ''}", flush=True)
    if done.returncode:
        print(done.stdout + done.stderr, file=sys.stderr)
    return done.returncode == 0


def run(command: list[str], folder: Path, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


def blocks(readme: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", readme, re.DOTALL)


def commands(readme: str) -> list[list[str]]:
    """Return the README's shell lines, without those of `make`, which need a checkout."""
    lines = [line for block in blocks(readme, "sh") for line in block.splitlines()]
    return [shlex.split(line) for line in lines if not line.startswith("make ")]


if __name__ == "__main__":
    sys.exit(main())
