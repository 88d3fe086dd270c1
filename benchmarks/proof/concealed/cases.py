"""A case as every track draws it: what a tool is given, what the judge keeps, and how both are written."""

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from concealed.plant.physics import Array

Columns = dict[str, Array]


@dataclass(frozen=True)
class Case:
    """Recordings as columns (time_s, input_v, output_um[, aux…]), the sealed labels, the held-out recording.

    A case on a real recording has the untouched recording in place of a held-out one.
    """

    recordings: list[Columns]
    labels: dict[str, object]
    heldout: Columns | None = None
    untouched: list[Columns] = field(default_factory=list)


def write_given(case: Case, folder: Path) -> None:
    """Write what a tool is given: FOLDER/a.csv to e.csv, and heldout_input.csv if it is to predict."""
    write_recordings(case.recordings, folder)
    if case.heldout is not None:
        given = {key: column for key, column in case.heldout.items() if key != "output_um"}
        write_csv(folder / "heldout_input.csv", given)


def write_recordings(recordings: list[Columns], folder: Path) -> None:
    """Write FOLDER/a.csv, b.csv, …"""
    for letter, columns in zip("abcde", recordings, strict=False):
        write_csv(folder / f"{letter}.csv", columns)


def write_case(case: Case, name: str, output: Path) -> None:
    """Write OUTPUT/NAME and OUTPUT/untouched_… for the tool, and OUTPUT/sealed for the judge."""
    write_given(case, output / name)
    if case.untouched:
        write_recordings(case.untouched, output / str(case.labels["untouched"]))
    if case.heldout is not None:
        write_csv(output / "sealed" / f"{name}_heldout.csv", case.heldout)
    seal = output / "sealed" / f"{name}.json"
    seal.parent.mkdir(parents=True, exist_ok=True)
    seal.write_text(json.dumps({"case": name, **case.labels}, indent=1) + "\n")


def write_csv(path: Path, columns: Columns) -> None:
    """Write a recording in the agreed format: a header, then one line per sample, with ten digits."""
    path.parent.mkdir(parents=True, exist_ok=True)
    table = np.column_stack(list(columns.values()))
    line = ",".join("%.9f" if name == "time_s" else "%.10g" for name in columns) + "\n"
    path.write_text(",".join(columns) + "\n" + line * len(table) % tuple(table.ravel().tolist()))


def read_column(path: Path, name: str) -> Array:
    """Read one column of a recording."""
    with path.open() as file:
        index = file.readline().strip().split(",").index(name)
    return np.loadtxt(path, delimiter=",", skiprows=1, usecols=index)
