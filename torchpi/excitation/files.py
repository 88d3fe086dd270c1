"""Excitations written to files for playing, `time_s,input_v` as CSV, with instructions beside them."""

from pathlib import Path

import numpy as np

from torchpi.excitation.limits import DriveLimits
from torchpi.excitation.sets import diagnostic_excitations
from torchpi.excitation.signals import Samples
from torchpi.files import check_output_folder, write_columns, write_text

INSTRUCTIONS = "WHAT_TO_DO.txt"


def write_excitation(path: str | Path, t: np.ndarray, u: np.ndarray) -> None:
    """Write `time_s,input_v` as CSV, t (time,), s, and u (time,), V, every double exact."""
    write_columns(path, ("time_s", "input_v"), (t.tolist(), u.tolist()))


def write_diagnostic_set(folder: Path, limits: DriveLimits, seed: int = 0) -> str:
    """Write the set for a diagnosis, numbered in the order of playing, and return the instructions.

    Raises:
        ConfigError: the set cannot respect the limits. Nothing is written then.
        ArtifactError: the folder cannot be written to.
    """
    check_output_folder(folder)
    made = diagnostic_excitations(limits, seed)
    files = {f"{number}_{name}.csv": samples for number, (name, samples) in enumerate(made.items(), 1)}
    text = instructions(folder, files, limits)
    for name, (t, u) in files.items():
        write_excitation(folder / name, t, u)
    write_text(folder / INSTRUCTIONS, text + "\n")
    return text


def instructions(folder: Path, files: dict[str, Samples], limits: DriveLimits) -> str:
    """Return the instructions for whoever plays and records these files."""
    fs_hz = limits.sample_rate_hz
    seconds = sum(len(u) for _, u in files.values()) / fs_hz
    rows = "\n".join(
        f"  {name:22s} {len(u) / fs_hz:5.1f} s   {u.min():8.4g} to {u.max():.4g} V   "
        f"at most {np.abs(np.diff(u)).max() * fs_hz:.4g} V/s"
        for name, (_, u) in files.items()
    )
    first, *_, last_but_one, last = files
    return f"""\
Six excitations for a diagnosis, {seconds:.0f} s in total, at {fs_hz:g} Hz, columns time_s,input_v.

{rows}

1. Let the stage rest at 0 V, with its usual load, until it no longer moves.
2. Play {first} to {last_but_one} in this order, one sample every {1 / fs_hz:g} s, held between
   samples. Rest at 0 V for a few seconds between them. input_v is the voltage of the controller, before
   the amplifier.
3. Wait ten minutes at 0 V, then play {last}.
4. Record each into its own CSV with the columns time_s,input_v,output_um, from the first sample on: the
   voltage in V, the displacement in µm, both on one clock. Any other signal that may matter, such as a
   temperature or another axis, goes into a further column whose name begins with aux_.
5. torchpi diagnose RECORDED.csv … --output {folder / "diagnosis"}"""
