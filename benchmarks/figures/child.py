"""Run Python in a process that ends with the one that started it, however that one ends.

python -m benchmarks.figures.child PARENT -m MODULE [ARGUMENTS]
python -m benchmarks.figures.child PARENT FILE [ARGUMENTS]
"""

import runpy
import sys
from pathlib import Path

from torchpi.cli.workers import end_with_parent


def main(parent: str, *words: str) -> None:
    end_with_parent(int(parent))
    if words[0] == "-m":
        sys.argv[:] = words[1:]
        runpy.run_module(words[1], run_name="__main__", alter_sys=True)
    else:
        file = Path(words[0]).resolve()
        sys.argv[:] = [str(file), *words[1:]]
        sys.path[0] = str(file.parent)
        runpy.run_path(str(file), run_name="__main__")


if __name__ == "__main__":
    main(*sys.argv[1:])
