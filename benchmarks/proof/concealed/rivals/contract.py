"""The parts of a tool's two commands that all rivals share."""

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Run = dict[str, NDArray[np.float64]]
Errors = tuple[float, float, float]
MOST = 120_000  # rows that a rival fits


def command_line(
    description: str | None,
    diagnose: Callable[[list[Run], Path], None],
    predict: Callable[[dict, Run], NDArray],
) -> None:
    """Run `diagnose a.csv … --output DIR` or `predict DIR/stage.json in.csv --output out.csv`."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("verb", choices=("diagnose", "predict"))
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--output", type=Path, required=True)
    options = parser.parse_args()
    if options.verb == "diagnose":
        diagnose([read(file) for file in options.files], options.output)
        return
    run = read(options.files[1])
    y = predict(json.loads(options.files[0].read_text()), run)
    columns = np.column_stack([run["time_s"], run["input_v"], y])
    np.savetxt(options.output, columns, "%.9g", ",", header="time_s,input_v,output_um", comments="")


def read(path: Path) -> Run:
    """Read the columns of a recording, and its sample period `dt`."""
    with path.open() as file:
        names = file.readline().strip().split(",")
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    run = dict(zip(names, table.T, strict=True))
    return run | {"dt": np.median(np.diff(run["time_s"]))}


def write_diagnosis(output: Path, effects: Sequence[dict], errors: Sequence[Errors], stage: dict) -> None:
    """Write the agreed diagnosis.json, with the errors before and after the effects, and the stage."""
    fits = [dict(zip(("train_rms_um", "heldout_rms_um", "heldout_max_um"), e, strict=True)) for e in errors]
    answer = {
        "verdict": "explained" if effects else "nothing_missing",
        "effects": list(effects),
        "where": [],
        "fit": {"nominal": fits[0], "retuned": fits[0], "augmented": fits[-1]} if fits else {},
    }
    output.mkdir(parents=True, exist_ok=True)
    (output / "stage.json").write_text(json.dumps(stage))
    (output / "diagnosis.json").write_text(json.dumps(answer, indent=1) + "\n")


def named(name: str, of: int, parameters: dict | None = None, alternatives: Sequence[str] = ()) -> dict:
    """One of `of` effects, with full certainty, because rivals have no probabilities."""
    return {
        "name": name,
        "alternatives": list(alternatives),
        "probability": 1.0,
        "parameters": parameters or {},
        "share": 1.0 / of,
    }
