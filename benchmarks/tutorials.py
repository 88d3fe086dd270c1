"""How long does each tutorial take, run block by block as it stands, and does every block succeed?

    python benchmarks/tutorials.py [--only mismatch,csv_to_controller,adding_an_effect,notebook]

Each page has an empty folder of its own. Its shell blocks are run as they are; its Python blocks share their
names, as in a notebook. Exits with 1 where a block fails or a tutorial takes two minutes or more.
"""

import argparse
import os
import re
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
    taken = {page: seconds_of((DOCS / f"{page}.md").read_text(encoding="utf-8")) for page in pages}
    for page, seconds in taken.items():
        print(f"{page}: {seconds:.0f} s")
    return 1 if max(taken.values()) >= LONGEST_S else 0


def seconds_of(page: str) -> float:
    """Of all its blocks, one after the other.

    Raises:
        SystemExit: One of them failed.
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
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{command[-1]}\nexit {done.returncode}: {done.stderr.strip()[-500:]}")


if __name__ == "__main__":
    sys.exit(main())
