"""The proof's command line.

    concealed generate --track alien --seed 7000 --count 6 --output cases    # to develop on
    concealed run --seed 7000 --limit 6 --output runs/development            # likewise
    concealed draw --count 300 --output seeds.json                           # once, after the freeze
    concealed run seeds.json --entry torchpi --output runs/torchpi --executor processes:2
    concealed page runs/torchpi runs/baseline runs/sindy --output docs/proof.md

`run` continues an interrupted run. Another tool takes part with --name, --diagnose and --predict.
"""

import argparse
import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from concealed.cases import write_case
from concealed.entries import ENTRIES, Entry
from concealed.run import RunError, check_frozen, development_seeds, draw_seeds, open_executor, run
from concealed.tracks import DATA, DEVELOPMENT, PROOF, draw


def main(arguments: list[str] | None = None) -> None:
    """Run one verb."""
    parser = argparse.ArgumentParser(
        prog="concealed", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(dest="verb", required=True)

    verb = verbs.add_parser("generate", help="write cases, with their labels sealed apart")
    verb.set_defaults(do=_generate)
    verb.add_argument(
        "--track", choices=("all", *PROOF, *DEVELOPMENT), required=True, help="all: the four of the proof"
    )
    verb.add_argument("--count", type=int, default=6, help="of cases in each track")
    verb.add_argument("--first", type=int, default=1, help="number of the first case")
    verb.add_argument("--seed", type=int, default=0, help="0 to 9999 are for development")
    verb.add_argument("--output", type=Path, required=True, help="gets a folder for each track")
    verb.add_argument("--data", type=Path, default=DATA, help="folder of the real recordings")
    verb.add_argument("--processes", type=int, default=1)

    verb = verbs.add_parser("draw", help="draw the seeds of a run, from a committed tree")
    verb.set_defaults(
        do=lambda o: print(json.dumps(draw_seeds(o.output, dict.fromkeys(PROOF, o.count)), indent=1))
    )
    verb.add_argument("--count", type=int, default=300, help="of cases in each track")
    verb.add_argument("--output", type=Path, required=True)

    verb = verbs.add_parser("run", help="put the cases of a file of seeds to a tool, and grade its answers")
    verb.set_defaults(do=_run)
    verb.add_argument("seeds", type=Path, nargs="?", help="what `draw` wrote; without it, --seed")
    verb.add_argument("--seed", type=int, default=0, help="0 to 9999: a run for development, of any tree")
    verb.add_argument("--entry", choices=tuple(ENTRIES), default="torchpi")
    verb.add_argument("--name", help="of another tool")
    verb.add_argument("--diagnose", help="its command, with {recordings} and {out}")
    verb.add_argument("--predict", default="", help="its command, with {out}, {input} and {prediction}")
    verb.add_argument("--timeout-s", type=float, default=900.0, help="of one command")
    verb.add_argument("--output", type=Path, required=True)
    verb.add_argument("--executor", default="processes:1", help="processes:N, or dask:ADDRESS")
    verb.add_argument("--tracks", nargs="*", choices=PROOF, default=PROOF)
    verb.add_argument("--limit", type=int, help="only the first so many cases of each track (6 with --seed)")
    verb.add_argument("--data", type=Path, default=DATA, help="folder of the real recordings")
    verb.add_argument("--not-frozen", action="store_true", help="run whatever the tree holds")

    verb = verbs.add_parser("page", help="write the page from the results; the first folder is the tool's")
    verb.set_defaults(do=_page)
    verb.add_argument("results", type=Path, nargs="+", help="folders that `run` wrote")
    verb.add_argument("--output", type=Path, required=True, help="its pictures go into a folder of its name")
    verb.add_argument(
        "--data", type=Path, default=DATA, help="folder of the real recordings, for the worst cases"
    )

    options = parser.parse_args(arguments)
    try:
        options.do(options)
    except RunError as error:
        sys.exit(f"concealed {options.verb}: {error}")


def _generate(options: argparse.Namespace) -> None:
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
    """Write one case and return its name, which reveals nothing of its content."""
    name = f"case_{number:04d}"
    write_case(draw(track, seed, number - 1, data), name, output)
    return f"{track}/{name}"


def _run(options: argparse.Namespace) -> None:
    if options.seeds is None:
        seeds = development_seeds(options.seed, options.limit or 6)
    else:
        seeds = json.loads(options.seeds.read_text())
        if not options.not_frozen:
            check_frozen(seeds, [options.seeds, options.output])
    entry = ENTRIES[options.entry]
    if options.diagnose:
        entry = Entry(options.name or "entry", options.diagnose, options.predict, options.timeout_s)
    if options.executor.startswith("processes"):  # on a cluster only the workers need the tool
        entry.check_programs()
    with open_executor(options.executor) as executor:
        results = run(seeds, entry, options.output, executor, options.data, options.tracks, options.limit)
    from concealed.page.text import figure_table

    print(figure_table({entry.name: results}, tracks=True))


def _page(options: argparse.Namespace) -> None:
    from concealed.page.text import write_page

    results = [json.loads((folder / "results.json").read_text()) for folder in options.results]
    write_page({found["entry"]: found for found in results}, options.output, options.data)


if __name__ == "__main__":
    main()
