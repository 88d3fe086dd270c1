"""Reader of text: CSV with a header row, or columns of numbers without one.

The delimiter (comma, semicolon, tab or white space), a decimal comma, lines before the header and a row of
units below it are recognised from the first rows. Blank lines and lines that begin with `#` are skipped, but
they count in the row numbers of messages. A column may hold time stamps of ISO 8601.
"""

import csv
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from torchpi.errors import RecordingError
from torchpi.recordings.readers.header import known_unit, stem_and_unit
from torchpi.recordings.readers.iso_time import is_stamp, seconds_of
from torchpi.recordings.readers.source import Source, shortened

SNIFFED_LINES = 400
SEPARATOR = re.compile(r'"?sep=(.)"?')  # optional first line that spreadsheets write


def open_file(path: str) -> "TextSource":
    return TextSource(path)


@dataclass(frozen=True)
class Dialect:
    """How a line is split into cells, and how a cell is read as a number."""

    delimiter: str | None
    decimal_comma: bool

    def cells(self, line: str) -> list[str]:
        if self.delimiter is None:
            return line.split()
        try:
            cells = next(csv.reader([line], delimiter=self.delimiter, skipinitialspace=True), [])
        except csv.Error:  # a NUL, or a cell of more than 128 KiB
            cells = line.split(self.delimiter)
        return [cell.strip() for cell in cells]

    def is_number(self, cell: str) -> bool:
        try:
            float(cell.replace(",", ".") if self.decimal_comma else cell)
        except ValueError:
            return False
        return "_" not in cell and cell.isascii()  # Python reads 1_000 as a number, numpy does not


class TextSource(Source):
    """A table of text."""

    def __init__(self, path: str, skip_lines: int = 0) -> None:
        self.encoding = text_encoding(path)
        with open(path, encoding=self.encoding, errors="replace") as file:
            lines = [line.rstrip("\r\n") for line in islice(file, SNIFFED_LINES)]
        head = [
            (n, line) for n, line in enumerate(lines, start=1) if n > skip_lines and not _is_passed_over(line)
        ]
        if not head:
            raise RecordingError(
                f"{path}: no row holds any data, expected a header and numbers; record it again"
            )
        stated = SEPARATOR.fullmatch(head[0][1])
        head = head[1:] if stated and len(head) > 1 else head
        bulk = [line for _, line in head[len(head) // 2 :]]
        self.dialect, self.kinds = _recognised(bulk, stated[1] if stated else None)
        first_row, number = self._first_row(head)
        above = [line for line in lines[skip_lines : number - 1] if line.strip()]
        names, units = self._header(above)
        self.has_header = bool(names)
        # Line numbers in the file, used by numpy and for the row numbers of messages.
        self.skipped_lines = number - 1
        if not self.has_header and first_row is not None:
            names = [str(k) for k in range(1, len(self.kinds) + 1)]
        elif not self.has_header:  # no cell is a number, so the first row must be a header
            names, self.has_header, self.skipped_lines = self.dialect.cells(head[0][1]), True, head[0][0]
        super().__init__(path, names)
        self.units = {name: unit for name, unit in units.items() if unit is not None}
        repeated = next((name for name, count in Counter(names).items() if name and count > 1), None)
        if repeated is not None:
            raise RecordingError(
                f"{path}: row {self.skipped_lines}: the column name '{repeated}' occurs twice, "
                f"expected each name once; rename one"
            )

    def read(self, names: list[str]) -> list[np.ndarray]:
        chosen = [self.names.index(name) for name in names]
        if next(self.numbered(), None) is None:
            raise RecordingError(
                f"{self.path}: no row of numbers below the header; record or export it again"
            )
        plain = [k for k in chosen if k not in self._stamped]
        try:
            table = dict(zip(plain, self._table(plain).T, strict=True)) if plain else {}
            for column in set(chosen) & self._stamped:
                table[column] = seconds_of(self._table([column], kind=str)[:, 0])
        except ValueError as error:
            raise self._first_fault(chosen) or RecordingError(
                f"{self.path}: cannot be read as a table of numbers ({error})"
            ) from None
        found = [np.ascontiguousarray(table[column]) for column in chosen]
        self._check_widths(len(found[0]) if found else 0)
        return found

    def holds_numbers(self, name: str) -> bool:
        return self.kinds[self.names.index(name)] != "text"

    def place(self, index: int) -> str:
        line = next(islice(self.numbered(), index, None), None)
        return f"row {line[0]}" if line else f"sample {index + 1}"

    def numbered(self) -> Iterator[tuple[int, str]]:
        """Yield (line number in the file, line) of every row of numbers, with decimal commas made points."""
        with open(self.path, encoding=self.encoding, errors="replace") as lines:
            for number, line in enumerate(lines, start=1):
                if number > self.skipped_lines and not _is_passed_over(line):
                    row = line.rstrip("\r\n")
                    yield number, row.replace(",", ".") if self.dialect.decimal_comma else row

    @property
    def _stamped(self) -> set[int]:
        return {k for k, kind in enumerate(self.kinds) if kind == "stamp"}

    def _table(self, columns: list[int], kind: type = float) -> np.ndarray:
        comma = self.dialect.decimal_comma
        return np.loadtxt(
            [line for _, line in self.numbered()] if comma else self.path,
            dtype=kind,
            delimiter=self.dialect.delimiter,
            skiprows=0 if comma else self.skipped_lines,
            usecols=columns,
            ndmin=2,
            quotechar='"',
            encoding=self.encoding,
        )

    def _check_widths(self, rows: int) -> None:
        """Raise RecordingError for a row with more cells than the others: a decimal comma would shift them.

        Counting the delimiters of the whole file is cheap; rows are examined only if the count differs.
        """
        delimiter = self.dialect.delimiter
        if delimiter is None or not rows:
            return
        first = next(self.numbered())[1]
        with open(self.path, encoding=self.encoding, errors="replace") as file:
            for _ in range(self.skipped_lines):
                file.readline()
            count = sum(part.count(delimiter) for part in iter(lambda: file.read(1 << 22), ""))
        if count == rows * first.count(delimiter):
            return
        width = max(len(self.names), len(self.dialect.cells(first)))
        for row, line in self.numbered():
            cells = self.dialect.cells(line)
            if any(cells[width:]):
                raise RecordingError(
                    f"{self.path}: row {row}: found {len(cells)} cells, expected {width}; "
                    "correct the row (a decimal comma between commas?) or delete it"
                )

    def _offers(self, name: str) -> bool:
        if not self.has_header and not name.isdigit():
            raise RecordingError(
                f"{self.path}: has no header row, so no column '{name}'; "
                f"choose columns by number, 1 to {len(self.names)} (options input_column, output_column), "
                f"and time by its number (time_column) or by the sample rate (fs_hz)"
            )
        return False

    def _first_row(self, head: list[tuple[int, str]]) -> tuple[int | None, int]:
        """Return (index in `head`, line number) of the first row of numbers, past lines before the header."""
        rows = [self.dialect.cells(line) for _, line in head]
        good = [self._holds_numbers(cells) for cells in rows]
        following = [*good[1:], True]
        first = next((k for k, both in enumerate(zip(good, following, strict=True)) if all(both)), None)
        if first is None:
            return None, head[0][0] + 1
        # A faulty row just above belongs to the table too; reading the numbers will report it.
        while (
            first > 0 and head[first - 1][0] == head[first][0] - 1 and self._holds_a_number(rows[first - 1])
        ):
            first -= 1
        return first, head[first][0]

    def _holds_numbers(self, cells: list[str]) -> bool:
        return "number" in self.kinds and all(
            kind == "text" or (k < len(cells) and self._is_of_kind(cells[k], kind))
            for k, kind in enumerate(self.kinds)
        )

    def _holds_a_number(self, cells: list[str]) -> bool:
        return len(cells) >= len(self.kinds) and any(
            kind != "text" and self._is_of_kind(cell, kind)
            for cell, kind in zip(cells, self.kinds, strict=False)
        )

    def _is_of_kind(self, cell: str, kind: str) -> bool:
        return is_stamp(cell) if kind == "stamp" else self.dialect.is_number(cell)

    def _header(self, above: list[str]) -> tuple[list[str], dict[str, str | None]]:
        """Return names and the units of a row of units, from lines above the numbers, comments included."""
        plain = [line for line in above if not line.startswith("#")]
        commented = [line.lstrip("#%/ ") for line in reversed(above) if line.startswith(("#", "%", "//"))]
        units: list[str] = []
        for line in [*plain[-1:], *plain[-2:-1], *commented]:
            cells = self._names_in(line)
            if cells and not units and _are_units(cells) and len(above) > 1:
                units = cells
            elif cells:
                stated = {name: known_unit(_bare(unit)) for name, unit in zip(cells, units, strict=False)}
                return cells, stated | {
                    name: unit
                    for name in cells
                    if name not in stated or not stated[name]
                    if (unit := stem_and_unit(name)[1])
                }
        return [], {}

    def _names_in(self, line: str) -> list[str]:
        """Return the cells of a line that could be a header of these columns, else an empty list."""
        cells, width = self.dialect.cells(line), len(self.kinds)
        if self.dialect.delimiter is None and len(cells) != width:
            cells = re.split(r"\s{2,}", line.strip())
        trailing = len(cells) - width in (0, 1)  # or one more, for comments that the rows leave out
        if not trailing or any(self.dialect.is_number(cell) for cell in cells) or not any(cells):
            return []
        return cells[:width]

    def _first_fault(self, chosen: list[int]) -> RecordingError | None:
        """Find the first cell that is not a number: a slow search, made only once reading has failed."""
        for row, line in self.numbered():
            cells = self.dialect.cells(line)
            for column in chosen:
                label = f"{self.path}: row {row}: column '{self.names[column]}'"
                stamped = column in self._stamped
                expected = "a time stamp" if stamped else "a number"
                if column >= len(cells) or not cells[column]:
                    return RecordingError(
                        f"{label}: found nothing, expected {expected} (this row has {len(cells)} cells, "
                        f"the first one {len(self.names)}: {shortened(self.names)}); "
                        "complete the row or delete it"
                    )
                if not self._is_of_kind(cells[column], "stamp" if stamped else "number"):
                    return RecordingError(
                        f"{label}: found '{cells[column][:40]}', expected {expected}; "
                        "correct the row or delete it"
                    )
        return None


def text_encoding(path: str) -> str:
    """Detect the encoding from the head of the file: UTF-16 by its mark, UTF-8, else Latin-1 (for a µ)."""
    with open(path, "rb") as file:
        head = file.read(1 << 16)
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if b"\0" in head:
        raise RecordingError(
            f"{path}: holds binary data, expected text; give the file the suffix of its format"
        )
    try:
        head[: head.rfind(b"\n") + 1].decode("utf-8-sig")
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8-sig"


def _recognised(bulk: list[str], stated: str | None) -> tuple[Dialect, list[str]]:
    """Return the dialect in which most columns of these rows are numbers, and the kind of each column.

    `bulk` is the second half of the first lines, below the header. A kind is number, stamp or text.
    """
    best: tuple[float, int, int] = (-1.0, 0, 0)
    found: tuple[Dialect, list[str]] = (Dialect(stated, False), ["text"])
    for delimiter in (stated,) if stated else (";", "\t", ",", None):
        for decimal_comma in (False, True) if delimiter != "," else (False,):
            dialect = Dialect(delimiter, decimal_comma)
            kinds = _kinds(dialect, [dialect.cells(line) for line in bulk])
            numbers = sum(kind != "text" for kind in kinds)
            score = (numbers / max(1, len(kinds)), numbers, len(kinds))
            if score > best:
                best, found = score, (dialect, kinds)
    return found


def _kinds(dialect: Dialect, rows: list[list[str]]) -> list[str]:
    width = Counter(len(cells) for cells in rows).most_common(1)[0][0]
    rows = [cells for cells in rows if len(cells) == width]
    if width > 1 and not any(cells[-1] for cells in rows):  # every row ends with a delimiter
        width -= 1
    kinds = []
    for k in range(width):
        column = [cells[k] for cells in rows]
        numbers, stamps = sum(map(dialect.is_number, column)), sum(map(is_stamp, column))
        kinds.append(
            "stamp" if 2 * stamps > len(column) else "number" if 2 * numbers >= len(column) else "text"
        )
    return kinds


def _is_passed_over(line: str) -> bool:
    return not line.strip() or line.startswith("#")


def _are_units(cells: list[str]) -> bool:
    known = [known_unit(_bare(cell)) is not None for cell in cells]
    return any(known) and all(
        k or _bare(cell) in ("", "-", "1") for k, cell in zip(known, cells, strict=True)
    )


def _bare(cell: str) -> str:
    return cell.strip().strip("[](){}").strip()
