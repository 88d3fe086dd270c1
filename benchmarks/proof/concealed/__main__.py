"""The command line of the proof.

    python -m concealed generate --track alien --seed 7000 --count 6 --output cases
"""

import argparse
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from concealed.cases import write_case
from concealed.tracks import DATA, DEVELOPMENT, PROOF, draw


def main(arguments: list[str] | None = None) -> None:
    """Run one verb."""
    parser = argparse.ArgumentParser(
        prog="concealed", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    verb = verbs.add_parser("generate", help="write cases, with their labels sealed apart")
    verb.add_argument("--track", choices=(*PROOF, *DEVELOPMENT, "all"), required=True, help="all: the four of the proof")
    verb.add_argument("--count", type=int, default=6, help="of cases in each track")
    verb.add_argument("--first", type=int, default=1, help="number of the first case")
    verb.add_argument("--seed", type=int, default=0, help="0 to 9999 are for development")
    verb.add_argument("--output", type=Path, required=True, help="gets a folder for each track")
    verb.add_argument("--data", type=Path, default=DATA, help="folder of the real recordings")
    verb.add_argument("--processes", type=int, default=1)
    verb.set_defaults(run=generate)
    options = parser.parse_args(arguments)
    options.run(options)


def generate(options: argparse.Namespace) -> None:
    """Write the cases; what is printed gives nothing away."""
    tracks = PROOF if options.track == "all" else (options.track,)
    jobs = [
        (track, options.seed, number, options.output / track, options.data)
        for track in tracks
        for number in range(options.first, options.first + options.count)
    ]
    started = time.perf_counter()
    with ProcessPoolExecutor(options.processes) as pool:
        for line in pool.map(_generate_one, *zip(*jobs, strict=True)):
            print(line, flush=True)
    print(f"{len(jobs)} cases in {time.perf_counter() - started:.0f} s")


def _generate_one(track: str, seed: int, number: int, output: Path, data: Path) -> str:
    name = f"case_{number:04d}"
    write_case(draw(track, seed, number - 1, data), name, output)
    return f"{track}/{name}"


if __name__ == "__main__":
    main()
