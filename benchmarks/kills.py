"""Commands killed at random moments: previous files whole, nothing left running, the next run succeeds.

    python benchmarks/kills.py [--rounds 30] [--only fit,export,diagnose,reproduce,figures]

Each command is run once, then killed `rounds` times with each of SIGTERM, SIGKILL and SIGINT, and run to its
end after every kill.
"""

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.hostile.kills import commands, kill_often


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=30)
    parser.add_argument("--only", default="fit,export,diagnose,reproduce,figures")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        known = commands(Path(folder))
        for name in options.only.split(","):
            outcome = kill_often(known[name], options.rounds)
            counts = ", ".join(f"{count} {signal}" for signal, count in outcome.kills.items())
            print(f"{name}: {counts}; {len(outcome.faults)} faults", flush=True)
            print("".join(f"  {fault}\n" for fault in outcome.faults), end="", flush=True)


if __name__ == "__main__":
    main()
