"""docs/figures.md: every stated figure with its bound, and the command and date of its measurement."""

from collections.abc import Iterable, Mapping
from textwrap import fill
from typing import Any

from benchmarks.figures.figure import Measurement
from benchmarks.figures.pages import ROOT

PAGE = ROOT / "docs" / "figures.md"
INTRODUCTION = """# Every stated figure

<!-- Written by python -m benchmarks.figures -->

What README and docs state as measured, with the bound that the words around it rely on. `make figures`
measures all of it again; the tests measure the short ones, and hold every number on a page to this record.
Times are those of a shared machine, and their bounds are wide. `figures.json` beside this page has the same
for programs.
"""


def page(measurements: Iterable[Measurement], found: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the page as text: a table for each measurement, in the order of the registry."""
    parts = [INTRODUCTION]
    for one in measurements:
        entries = [(figure, found[figure.name]) for figure in one.figures if figure.name in found]
        if not entries:
            continue
        latest = max((entry for _, entry in entries), key=lambda entry: str(entry["date"]))
        parts.append(
            f"## {one.name.replace('_', ' ')}\n\n{fill(f'`{one.command}`', 120, break_on_hyphens=False)}\n\n"
            f"Measured on {latest['date']} at commit {latest['commit']}.\n\n"
            "| figure | measured | bound |\n|---|---|---|\n"
            + "".join(
                f"| `{figure.name}` | {figure.quoted(entry['value'])}{figure.unit_behind} "
                f"| {figure.bound} |\n"
                for figure, entry in entries
            )
        )
    return "\n".join(parts)
