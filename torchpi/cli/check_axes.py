"""Check recording files of several axes, print the findings and write one page: `torchpi check`."""

import shlex
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from torchpi.cli.check import table_of
from torchpi.errors import RecordingWarning
from torchpi.files import check_output_folder
from torchpi.recordings.faults import noise_estimate
from torchpi.recordings.multi_axis import MultiAxisRecording, read_multi_axis, usable
from torchpi.recordings.options import RecordingOptions
from torchpi.recordings.readers import open_source
from torchpi.recordings.summary import columns_in


def check_axes_files(
    paths: Sequence[Path], output: Path, options: RecordingOptions, command: str
) -> list[MultiAxisRecording]:
    """Print the contents of each file and the command to continue with, and write `check.html`.

    Args:
        paths: Recording files of one stage.
        output: Folder for the page.
        options: How the files are read.
        command: The command line as typed.

    Raises:
        RecordingError: A file cannot be used, or the files are not of one stage.
        ArtifactError: The output cannot be written to.
    """
    from torchpi.report.check_page import axes_section, write_sections
    from torchpi.report.what_was_run import provenance

    check_output_folder(output)
    found, sections = [], []
    for number, path in enumerate(paths, 1):
        columns = columns_in(open_source(path))
        print(f"{path}\n" + table_of(columns))
        one = read_multi_axis(path, options, None)
        facts = facts_of(one)
        print("\n".join(f"  {label:<12}{text}" for label, text in facts) + "\n")
        found.append(one)
        sections.append(axes_section(number, str(path), one, columns, facts))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", RecordingWarning)
        usable(found)
    for warning in caught:
        print(f"  warning     {warning.message}")
        sections[0]["warnings"].append(str(warning.message))
    names = [*map(str, paths), *options.as_arguments()]
    commands = [shlex.join(["torchpi", "diagnose", *names])]
    print(commands[0])
    files: dict[str, str | Path] = {
        f"recording {one.name}": path for one, path in zip(found, paths, strict=True)
    }
    title = "Check of " + ", ".join(one.name for one in found)
    page = write_sections(title, sections, [], commands, provenance(command, files), output / "check.html")
    print(f"{page}: the page")
    return found


def facts_of(one: MultiAxisRecording) -> list[tuple[str, str]]:
    """Describe the properties of a recording in plain words: (property, description)."""
    inputs, outputs = one.u.shape[1], one.y.shape[1]
    facts = [
        ("columns", f"{inputs} inputs (V), {outputs} outputs (µm)"),
        ("sampling", f"{one.fs_hz:.9g} Hz, {len(one.u):,} samples, {len(one.u) / one.fs_hz:.6g} s"),
        (
            "periods",
            f"{one.periods} of {len(one.u) // one.periods:,} samples; treated as the steady state"
            if one.periods > 1
            else "the inputs are not periodic, so the recording is fitted in the time domain",
        ),
    ]
    for i, u in enumerate(one.u.T, 1):
        moves = (
            f"{u.min():.4g} … {u.max():.4g} V, {u.std():.3g} V rms"
            if np.ptp(u)
            else f"{u[0]:.4g} V throughout"
        )
        facts.append((f"input {i}", moves))
    for o, y in enumerate(one.y.T, 1):
        noise = one.period[2] if one.periods > 1 else noise_estimate(y)
        what = "of the mean period" if one.periods > 1 else "from sample to sample"
        facts.append(
            (
                f"output {o}",
                f"{y.min():.4g} … {y.max():.4g} µm, {y.std():.3g} µm rms; noise {what} {noise:.2g} µm",
            )
        )
    return facts
