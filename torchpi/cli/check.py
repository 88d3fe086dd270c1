"""Check recording files, print the findings and write one page: `torchpi check`."""

import json
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from torchpi.errors import RecordingError
from torchpi.files import check_output_folder
from torchpi.recordings.checks import AWAY_FROM_ZERO
from torchpi.recordings.options import RecordingOptions
from torchpi.recordings.readers import open_source
from torchpi.recordings.summary import PREVIEWED, Column, Summary, columns_in, summarise

OUR_UNITS = {"time": "s", "input": "V", "output": "µm"}


def check_files(
    paths: Sequence[Path], output: Path, options: RecordingOptions, command: str
) -> list[Summary]:
    """Print the contents of each file and the commands to continue with, and write `check.html`.

    Each unusable file is reported on its own line, and the others are still described; the page covers
    the usable files.

    Args:
        paths: the recording files.
        output: folder for the page.
        options: how the files are read.
        command: the command line as typed.

    Raises:
        RecordingError: the last error, if any file cannot be used.
        ArtifactError: the output cannot be written to.
    """
    from torchpi.report.check_page import Checked, write_check
    from torchpi.report.what_was_run import provenance

    check_output_folder(output)
    checked: list[Checked] = []
    failures: list[RecordingError] = []
    for path in paths:
        try:
            columns = columns_in(open_source(path))
            print(f"{path}\n" + table_of(columns))
            summary = summarise(path, options)
        except RecordingError as error:
            if failures:
                print(f"torchpi: error: {failures[-1]}", file=sys.stderr)
            failures.append(error)
            continue
        facts = facts_of(summary)
        print("\n".join(f"  {label:<12}{text}" for label, text in facts))
        print("".join(f"  warning     {warning}\n" for warning in summary.warnings))
        checked.append(Checked(summary, columns, facts))
    commands = commands_for([each.summary for each in checked])
    for line in commands:
        print(line)
    if checked:
        files: dict[str, str | Path] = {
            f"recording {each.summary.recording.name}": each.summary.recording.source for each in checked
        }
        page = write_check(
            checked,
            [str(failure) for failure in failures],
            commands,
            provenance(command, files),
            output / "check.html",
        )
        print(f"{page}: the page")
    if failures:
        raise failures[-1]
    return [each.summary for each in checked]


def table_of(columns: Sequence[Column]) -> str:
    """Format name, unit, range and first values of each column as lines of text."""
    rows = [("column", "unit", "range", "first values"), *(row_of(column) for column in columns)]
    widths = [max(len(row[k]) for row in rows) for k in range(3)]
    return "\n".join(
        "  " + "  ".join([*(cell.ljust(width) for cell, width in zip(row, widths, strict=False)), row[3]])
        for row in rows
    )


def row_of(column: Column) -> tuple[str, str, str, str]:
    """Return (name, unit, range, first values) of a column as text."""
    if column.values is None or not len(column.values):
        return column.name, column.unit or "", "", column.problem or "empty"
    x = column.values[np.isfinite(column.values)]
    spread = f"{x.min():.6g} … {x.max():.6g}" if len(x) else "no finite number"
    return (
        column.name,
        column.unit or "not stated",
        spread,
        ", ".join(f"{value:.6g}" for value in column.values[:PREVIEWED]),
    )


def facts_of(summary: Summary) -> list[tuple[str, str]]:
    """Describe the properties of a recording in plain words: (property, description)."""
    recording, holds = summary.recording, summary.holds
    u, y = recording.u, recording.y
    roles = ", ".join(f"{role} '{name}' ({OUR_UNITS[role]})" for role, name in summary.columns.items())
    if summary.guessed:
        roles += ": identified by their content; verify that input and output are not swapped"
    sampling = f"{recording.fs_hz:.9g} Hz, {len(recording):,} samples, {recording.duration_s:.6g} s"
    if summary.jitter is None:
        sampling += "; no time stamps"
    elif summary.options.resample:
        sampling += f"; steps off by up to {100 * summary.jitter:.2g} % of the period: interpolated"
    else:
        sampling += f"; stamps within {100 * summary.jitter:.2g} % of the period"
    how = "noise-free: the command itself"
    if summary.input_is_noisy:
        how = f"noise about {summary.input_noise_v:.2g} V: a monitored voltage, or a fast command"
    held = "no holds, so the noise can only be estimated from sample to sample"
    if holds.count:
        held = f"{holds.count} hold{'s' if holds.count > 1 else ''}, {100 * holds.share:.2g} % of the time"
        held += f", the longest {holds.longest_s:.3g} s"
    return [
        ("columns", roles),
        ("sampling", sampling),
        ("input", f"{u.min():.4g} … {u.max():.4g} V; {how}; {held}"),
        (
            "output",
            f"{y.min():.4g} … {y.max():.4g} µm; noise about {summary.output_noise_um:.2g} µm; "
            f"smallest step {summary.output_step_um:.2g} µm",
        ),
        ("gain", _gain(summary)),
        ("start", _start(summary)),
        ("dropouts", f"{len(summary.dropouts)} single wrong readings" if len(summary.dropouts) else "none"),
    ]


def commands_for(summaries: Sequence[Summary]) -> list[str]:
    """Return command lines to paste: `fit` and `diagnose` with the options that these files need.

    Files that need different options get separate lines, because a command reads all its files alike.
    """
    groups: dict[RecordingOptions, list[str]] = {}
    for summary in summaries:
        groups.setdefault(summary.options, []).append(summary.recording.source)
    lines = []
    for options, files in groups.items():
        fit = ["torchpi", "train", "fit", "--config", "recorded"]
        fit += ["--data.recordings", json.dumps(files), *options.as_arguments("--data.")]
        lines.append(shlex.join(fit))
        lines.append(shlex.join(["torchpi", "diagnose", *files, *options.as_arguments()]))
    return lines


def _gain(summary: Summary) -> str:
    if np.ptp(summary.recording.u) == 0:
        return "the input is constant, so the gain cannot be determined"
    sign = (
        "positive" if summary.correlation > 0.5 else "negative" if summary.correlation < -0.5 else "not clear"
    )
    return (
        f"{summary.gain_um_per_v:.4g} µm/V on average, sign {sign} "
        f"(correlation at zero lag {summary.correlation:.2f})"
    )


def _start(summary: Summary) -> str:
    u, y = summary.recording.u, summary.recording.y
    text = f"{u[0]:.4g} V, {y[0]:.4g} µm"
    stroke, back = float(np.ptp(y)), summary.comes_back_um
    if back is None:
        return f"{text}; the input never returns to this voltage, so the remanence cannot be seen"
    if abs(u[0]) > AWAY_FROM_ZERO * np.ptp(u):
        return f"{text}; a voltage was already applied, so the initial state is unknown"
    falls = summary.correlation < 0.0  # the sensor is mounted the other way round
    if (-back if falls else back) > max(0.005 * stroke, 3 * summary.output_noise_um):
        where = f"{abs(back):.3g} µm {'lower' if falls else 'higher'}"
        return (
            f"{text}; when the input returns to this voltage, the output is {where}: the remanence of a "
            "stage that started de-energised"
        )
    return (
        f"{text}; when the input returns to this voltage, so does the output, to within {abs(back):.2g} µm: "
        "the first sample was not de-energised, or there is no hysteresis"
    )
