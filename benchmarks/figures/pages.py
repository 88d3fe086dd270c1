"""Quotations of figures on pages: a number, followed by a comment that names the figure.

    547 nm<!-- figure: commission_without_nm -->        the number before the comment is the figure
    about a minute<!-- in words: commission_s -->       the words stand for the figure's bound

Rendered Markdown does not show the comments.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmarks.figures.figure import Figure

ROOT = Path(__file__).parents[2]
# A number, the text between it and the comment (its unit; no other number), and the comment.
NUMBER = re.compile(
    r"(?P<number>\d[\d,]*(?:\.\d+)?(?:e-?\d+)?)(?P<unit>[^\d<\n]{0,16})<!-- figure: (?P<name>\w+) -->"
)
CODE = re.compile(r"`[^`\n]*`")
FENCED = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)
COMMENT = re.compile(r"<!-- (?P<kind>figure|in words): (?P<name>\w+) -->")

STATED = re.compile(
    r"\d(?:[\d,.]*\d)?(?:e-?\d+)? ?(?:nm|µm/s|µm|ms|µs|s|V|kHz|Hz|%|×|times|GB|MB|minutes)(?!\w)"
)
"""A number with a unit, as results are stated. Other numbers belong to names, counts and equations."""
MEASURED_ON = re.compile(r"Measured on \d{4}-\d\d-\d\d at commit [0-9a-f]{7,}")
"""The statement about its run on a page that is written entirely by a command."""


@dataclass(frozen=True)
class Quotation:
    """Where a figure is quoted; `number` and `unit` are as printed, or None if it is quoted in words."""

    page: str
    line: int
    name: str
    number: str | None
    unit: str | None


def pages() -> list[Path]:
    """Return all pages that may quote figures: README, docs, and the READMEs of benchmarks and exports."""
    found = [ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("benchmarks/**/README.md")]
    return sorted([*found, ROOT / "exports" / "README.md"])


def page_name(path: Path) -> str:
    """Return the name of a page in messages: its path from the root of the checkout."""
    return path.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else path.name


def quotations(paths: Iterable[Path]) -> Iterator[Quotation]:
    """Yield all quotations on these pages.

    Raises:
        ValueError: A comment has no number before it.
    """
    for path in paths:
        page = page_name(path)
        for at, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            line = CODE.sub(lambda code: " " * len(code[0]), line)
            numbers = {match.end(): match.group("number", "unit") for match in NUMBER.finditer(line)}
            for match in COMMENT.finditer(line):
                in_words = match["kind"] == "in words"
                if not in_words and match.end() not in numbers:
                    raise ValueError(
                        f"{page}:{at}: found no number before the comment of {match['name']}, expected one"
                    )
                number, unit = (None, None) if in_words else numbers[match.end()]
                yield Quotation(page, at, match["name"], number, unit and unit.strip(" *"))


def faults(paths: Iterable[Path], figures: Mapping[str, Figure], values: Mapping[str, float]) -> list[str]:
    """Faults of quotations, one line each: unknown, not measured, wrong number or unit, or missing."""
    out, quoted = [], set()
    for one in quotations(paths):
        quoted.add(one.name)
        where = f"{one.page}:{one.line}: {one.name}"
        if one.name not in figures:
            out.append(f"{where}: found no such figure, expected one of benchmarks/figures/registry.py")
        elif one.name not in values:
            out.append(f"{where}: found no value in docs/figures.json, expected one (make figures)")
        elif one.number is not None:
            figure = figures[one.name]
            right = figure.quoted(values[one.name])
            if one.number != right:
                out.append(f"{where}: found {one.number}, expected {right}, as measured (make figures)")
            if one.unit and figure.unit not in ("1", one.unit):
                out.append(f"{where}: found the unit {one.unit}, expected {figure.unit}")
    out += [f"{name}: found on no page, expected a quotation" for name in figures if name not in quoted]
    return out


def unregistered(paths: Iterable[Path], definitions: Mapping[str, frozenset[str]]) -> list[str]:
    """Numbers with units that are neither quoted figures nor definitions of their page, one line each."""
    out = []
    for path in paths:
        page = page_name(path)
        text = FENCED.sub(lambda block: "\n" * block[0].count("\n"), path.read_text(encoding="utf-8"))
        for at, line in enumerate(text.splitlines(), 1):
            line = CODE.sub(lambda code: " " * len(code[0]), line)
            out += [
                f"{page}:{at}: found {match[0]}, expected the comment of a figure behind it, or an entry in "
                "DEFINITIONS of benchmarks/figures/registry.py"
                for match in STATED.finditer(line)
                if not line.startswith("<!-- figure:", match.end())
                and match[0] not in definitions.get(page, frozenset())
            ]
    return out


def renew(path: Path, figures: Mapping[str, Figure], values: Mapping[str, float]) -> str:
    """Return the text of a page with every quoted number as measured; the words around it are kept."""

    def number(match: re.Match[str]) -> str:
        name = match["name"]
        if name not in figures or name not in values:
            return match[0]
        return match[0].replace(match["number"], figures[name].quoted(values[name]), 1)

    return NUMBER.sub(number, path.read_text(encoding="utf-8"))
