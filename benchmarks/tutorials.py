"""Run each tutorial block by block as written: how long does it take, and does every block succeed?

    python benchmarks/tutorials.py [--only mismatch,csv_to_controller,adding_an_effect,notebook]

Each page has an empty folder of its own. Its shell blocks are run as they are; its Python blocks share one
namespace, as in a notebook. Prints wall-clock and processor seconds; the latter depend less on other load on
the machine. Exits with 1 if a block fails or a tutorial takes two minutes or more by the clock.
"""

import argparse
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

DOCS = Path(__file__).parents[1] / "docs"
PAGES = ("mismatch", "csv_to_controller", "adding_an_effect", "notebook")
LONGEST_S = 120.0


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default=",".join(PAGES))
    pages = parser.parse_args().only.split(",")
    longest_s = 0.0
    for page in pages:
        before = processor_s()
        seconds = seconds_of((DOCS / f"{page}.md").read_text(encoding="utf-8"))
        print(f"{page}: {seconds:.0f} s, {processor_s() - before:.0f} processor s", flush=True)
        longest_s = max(longest_s, seconds)
    return 1 if longest_s >= LONGEST_S else 0


def processor_s() -> float:
    """Return the processor time of all commands run so far, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def seconds_of(page: str) -> float:
    """Run all blocks of a page and return the wall-clock time, s.

    Raises:
        SystemExit: A block failed.
    """
    started, before = time.perf_counter(), ""
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    with tempfile.TemporaryDirectory() as folder:
        for language, block in re.findall(r"^```(sh|python)\n(.*?)^```", page, re.DOTALL | re.MULTILINE):
            if language == "python":
                before += block
                continue
            run(["bash", "-ec", block], folder, environment)
        run([sys.executable, "-c", before], folder, environment)
    return time.perf_counter() - started


def run(command: list[str], folder: str, environment: dict[str, str]) -> None:
    started, before = time.perf_counter(), processor_s()
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    seconds, name = time.perf_counter() - started, command[-1].strip().splitlines()[-1]
    print(f"  {seconds:5.1f} s, {processor_s() - before:5.1f} processor s: {name[:90]}", flush=True)
    if done.returncode:
        raise SystemExit(f"{command[-1]}\nexit {done.returncode}: {done.stderr.strip()[-500:]}")


if __name__ == "__main__":
    sys.exit(main())
