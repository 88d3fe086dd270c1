"""Write real recordings with a known effect in them, and the same recordings without it.

    python benchmarks/real/inject.py --seed 0 --count 60 --output recordings/real

DIR/case_0001/{a,b}.csv are for the tool under test, DIR/untouched_NAME/ the recordings as they are;
DIR/sealed/ says what was done. Seeds 0–99 are for development; the figures that are published come from
seeds of 1000 and above.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from injection.case import PLANS, draw_case
from injection.sources import Array

DATA = Path(__file__).parents[3] / "shared" / "data"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--count", type=int, default=len(PLANS), help=f"of cases; each of the {len(PLANS)} plans once"
    )
    parser.add_argument("--first", type=int, default=1, help="number of the first case")
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the real recordings")
    parser.add_argument("--output", type=Path, required=True)
    options = parser.parse_args()
    for number in range(options.first, options.first + options.count):
        print(write_case(options.data, options.seed, number, options.output), flush=True)


def write_case(data: Path, seed: int, number: int, output: Path) -> str:
    """Write one case, its untouched recordings and its seal; returns a line that gives nothing away."""
    case, name = draw_case(data, seed, number - 1), f"case_{number:04d}"
    for folder, recordings in ((name, case.recordings), (case.untouched, case.untouched_recordings)):
        for letter, columns in zip("ab", recordings, strict=False):
            write_csv(output / folder / f"{letter}.csv", columns)
    seal = output / "sealed" / f"{name}.json"
    seal.parent.mkdir(parents=True, exist_ok=True)
    seal.write_text(json.dumps({"case": name, **case.labels}, indent=1) + "\n")
    return name


def write_csv(path: Path, columns: dict[str, Array]) -> None:
    """A recording by the contract; ten digits, which is more than any of the converters has."""
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(
        path, np.column_stack(list(columns.values())), "%.10g", ",", header=",".join(columns), comments=""
    )


if __name__ == "__main__":
    main()
