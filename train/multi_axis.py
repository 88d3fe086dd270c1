"""`python -m train fit --config …` for a stage of several axes: one stage.pt for all recordings."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from torchpi.errors import ConfigError, is_positive
from torchpi.identification.multi_axis import MultiAxisOptions, identify
from torchpi.identification.multi_axis.fit import PeriodicFit
from torchpi.identification.multi_axis.identify import by_amplitude, periods
from torchpi.recordings.multi_axis import (
    MultiAxisRecording,
    read_multi_axis,
    read_realisations,
    usable,
)
from torchpi.recordings.options import RecordingOptions
from torchpi.stage.multi_axis import MultiAxisStage

from .own_kind import files_named, leave, settings_of, whole_number

SECTION = "multi_axis"
READING = ("recordings", "fs_hz", "um_per_unit", "periods", "heldout")


def fit(arguments: Sequence[str], config: Path) -> None:
    """Identify the stage, judge it on the held-out recordings, and write stage.pt and metrics.json.

    Raises:
        ConfigError: An option or a key is unknown, or a value has another type.
        RecordingError: A recording cannot be used.
        ArtifactError: The output folder is in use or cannot be written to.
    """
    known = [field.name for field in fields(MultiAxisOptions)]
    settings, folder = settings_of(arguments, config, SECTION, [*READING, *known])
    every = usable(recordings(settings, config))
    heldout = settings.get("heldout", [])
    runs = [one.name for one in every]
    if not isinstance(heldout, list) or any(one not in runs for one in heldout):
        raise ConfigError(f"{config}: heldout: found {heldout}, expected a list of some of {', '.join(runs)}")
    fitted = [one for one in every if one.name not in heldout]
    values = {name: settings[name] for name in known if name in settings}
    if not isinstance(values.get("times_s", []), list):
        raise ConfigError(f"{config}: times_s: found {values['times_s']!r}, expected a list of numbers")
    if "times_s" in values:
        values["times_s"] = tuple(values["times_s"])
    stage = identify(fitted, MultiAxisOptions(**values), log=print)
    metrics = {
        "train": judged(stage, fitted),
        "heldout": judged(stage, [one for one in every if one.name in heldout]),
    }
    leave(folder, stage, metrics, {SECTION: settings})
    show(metrics)
    found = f"{stage.inputs} inputs, {stage.outputs} outputs, {stage.shapes.modes} modes"
    print(f"{folder / 'stage.pt'}: {found}")


def recordings(settings: Mapping[str, Any], config: Path) -> list[MultiAxisRecording]:
    """Read the recordings named in the config: an archive of realisations, or files with numbered columns.

    Raises:
        ConfigError: Neither is named, or a number is missing.
        RecordingError: A file cannot be read.
    """
    named = settings.get("recordings")
    if isinstance(named, str) and named.endswith(".npz"):
        numbers = (settings.get("fs_hz"), settings.get("um_per_unit", 1.0))
        for name, number in zip(("fs_hz", "um_per_unit"), numbers, strict=True):
            if not is_positive(number):
                raise ConfigError(f"{config}: {name}: found {number!r}, expected a positive number")
        return read_realisations(named, float(numbers[0]), float(numbers[1]))  # type: ignore[arg-type]
    files = files_named(config, named, "an archive or ")
    reading = RecordingOptions(fs_hz=settings.get("fs_hz"))
    given = settings.get("periods")
    periods = None if given is None else whole_number(config, "periods", given)
    return [read_multi_axis(one, reading, periods) for one in files]


def judged(stage: MultiAxisStage, every: Sequence[MultiAxisRecording]) -> list[dict[str, Any]]:
    """Return the rms error of the steady state over all outputs, µm, with noise and motion, level by level.

    The error is None if the response of the stage is unbounded.
    """
    found = []
    for one in (one for level in by_amplitude(every) for one in level):
        errors = PeriodicFit(stage, periods([one])).errors()
        squares = None if errors is None else np.mean([np.square(error).mean() for error in errors])
        found.append(
            {
                "name": one.name,
                "input_rms_v": float(one.u.std()),
                "rms_um": None if squares is None else float(np.sqrt(squares)),
                "noise_rms_um": one.period[2],
                "motion_rms_um": float(one.y.std()),
                "input_range_v": ranges(one.u),
                "output_range_um": ranges(one.y),
            }
        )
    return found


def ranges(x: np.ndarray) -> list[list[float]]:
    """Return the minimum and maximum of each channel."""
    return [[float(one.min()), float(one.max())] for one in x.T]


def show(metrics: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
    """Print one line for each recording."""
    for part, every in metrics.items():
        for one in every:
            error = "unbounded response" if one["rms_um"] is None else f"{one['rms_um']:.4f} µm rms"
            print(
                f"{part:>8}  {one['name']:<24} {error}, "
                f"noise {one['noise_rms_um']:.4f} µm, motion {one['motion_rms_um']:.3f} µm"
            )
