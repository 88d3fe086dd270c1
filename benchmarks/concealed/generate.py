"""Write concealed recordings, with their labels sealed apart.

    python benchmarks/concealed/generate.py --track single_pi --count 24 --seed 1 --output recordings/a

DIR/case_0001/{a,b,c}.csv (a to d with --recordings 4) and heldout_input.csv are for the tool under test;
DIR/sealed/ is for the judge.
Seeds 0–9999 are for development; the figures that are published come from seeds of 10000 and above.
"""

import argparse
import json
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from plant.case import TRACKS, Settings, draw_case
from plant.conditions import Conditions
from plant.physics import Array


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--track", choices=TRACKS, required=True)
    parser.add_argument("--count", type=int, default=24)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--first", type=int, default=1, help="number of the first case")
    parser.add_argument("--excitation", choices=("rich", "paper", "poor"), default="rich")
    parser.add_argument("--samples", type=int, default=33_000, help="of each recording")
    parser.add_argument("--timing", choices=("mixed", "end_of_hold", "before_write"), default="mixed")
    parser.add_argument("--effects", nargs="*", default=[], help="these names instead of drawn ones")
    parser.add_argument("--severity", type=float, help="this severity instead of a drawn one")
    around = parser.add_argument_group("conditions around the plant (nulls_conditions draws its own)")
    around.add_argument("--start", choices=("de_energised", "remanent"), default="de_energised")
    around.add_argument("--holds", choices=("kept", "replaced"), default="kept")
    around.add_argument("--input", choices=("command", "monitored"), default="command")
    around.add_argument("--recordings", type=int, choices=(1, 2, 3, 4), default=3)
    around.add_argument("--scale-v", type=float, default=1.0, help="factor on the voltages in the files")
    around.add_argument(
        "--scale-um", type=float, default=1.0, help="factor on the displacements in the files"
    )
    parser.add_argument("--processes", type=int, default=1)
    options = parser.parse_args()
    conditions = Conditions(
        remanent=options.start == "remanent",
        holds=options.holds == "kept",
        monitored=options.input == "monitored",
        recordings=options.recordings,
        scale_v=options.scale_v,
        scale_um=options.scale_um,
    )
    jobs = [
        (
            Settings(
                options.track,
                options.seed,
                number - 1,
                options.excitation,
                options.samples,
                options.timing,
                tuple(options.effects),
                options.severity,
                conditions,
            ),
            options.output,
            number,
        )
        for number in range(options.first, options.first + options.count)
    ]
    started = time.perf_counter()
    with ProcessPoolExecutor(options.processes) as pool:
        for line in pool.map(write_case, *zip(*jobs, strict=True)):
            print(line, flush=True)
    print(f"{options.count} cases in {time.perf_counter() - started:.0f} s")


def write_case(settings: Settings, output: Path, number: int) -> str:
    """Write one case and its seal; returns a line that gives nothing away."""
    case, name = draw_case(settings), f"case_{number:04d}"
    for letter, recording in zip("abcd", case.recordings, strict=False):
        write_csv(output / name / f"{letter}.csv", recording)
    write_csv(
        output / name / "heldout_input.csv", {k: v for k, v in case.heldout.items() if k != "output_um"}
    )
    write_csv(output / "sealed" / f"{name}_heldout.csv", case.heldout)
    (output / "sealed" / f"{name}.json").write_text(
        json.dumps({"case": name, **case.labels}, indent=1) + "\n"
    )
    return name


def write_csv(path: Path, columns: dict[str, Array]) -> None:
    """A recording by the contract: header, then one line a sample."""
    path.parent.mkdir(parents=True, exist_ok=True)
    table = np.column_stack(list(columns.values()))
    small = {name for name, column in columns.items() if np.max(np.abs(column)) < 1}
    formats = ("%.9f" if name == "time_s" else "%.10g" if name in small else "%.6f" for name in columns)
    line = ",".join(formats) + "\n"
    path.write_text(",".join(columns) + "\n" + line * len(table) % tuple(table.ravel().tolist()))


if __name__ == "__main__":
    main()
