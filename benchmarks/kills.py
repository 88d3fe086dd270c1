"""Kill commands during their run: previous files stay whole, nothing keeps running, the next run succeeds.

    python benchmarks/kills.py [--rounds 30] [--finish_every 6] [--seed 0]
        [--only fit,export,diagnose,reproduce,check,figures]

Each command is first run once with small inputs (`figures`: two of the measurements of `make figures`). It is
then killed at moments spread evenly over its run, until `rounds` of each of SIGTERM, SIGKILL and SIGINT have
arrived before its end. After every kill the files must be whole and no process may still be running. Every
run starts from what the killed run before it left, and must not fail by itself. After every `finish_every`-th
kill, and after the last, a run to the end must succeed and leave no temporary file. Counts are printed after
each of these runs, so they remain valid if this program is stopped early.
"""

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.hostile.kills import Outcome, commands, figures, kill_often


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=30)
    parser.add_argument("--finish_every", type=int, default=6)
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    parser.add_argument("--only", default="fit,export,diagnose,reproduce,check,figures")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        known = commands(Path(folder))
        for name in options.only.split(","):
            outcome = kill_often(
                figures(Path(folder)) if name == "figures" else known[name],
                options.rounds,
                options.seed,
                finish_every=options.finish_every,
                watch=lambda so_far, name=name: print(
                    f"  {counts(name, so_far)}", file=sys.stderr, flush=True
                ),
            )
            print(counts(name, outcome), flush=True)
            print("".join(f"  {fault}\n" for fault in outcome.faults), end="", flush=True)


def counts(name: str, outcome: Outcome) -> str:
    kills = ", ".join(f"{count} {signal}" for signal, count in outcome.kills.items())
    return f"{name}: {kills}; {len(outcome.faults)} faults"


if __name__ == "__main__":
    main()
