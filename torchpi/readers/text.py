"""Text: CSV with a header row, or columns of numbers without one.

The delimiter (comma, semicolon, tab or white space) and a decimal comma are recognised from the first rows.
Blank lines, and lines that begin with `#`, are passed over, but counted in the row numbers of messages.
"""

import csv
from collections.abc import Iterator
from itertools import islice

import numpy as np

from torchpi.errors import RecordingError
from torchpi.readers.source import Source, shortened

SNIFFED_ROWS = 50


def open_file(path: str) -> "TextSource":
    return TextSource(path)


class TextSource(Source):
    def __init__(self, path: str) -> None:
        self.encoding = _encoding(path)
        head = list(islice(_rows(path, self.encoding), SNIFFED_ROWS))
        if not head:
            raise RecordingError(
                f"{path}: no row holds any data, wanted a header and numbers; record it again"
            )
        # A first row of words says nothing about the decimal sign: the second row is a row of numbers.
        self.delimiter = _delimiter(head[1][1] if len(head) > 1 else head[0][1])
        self.decimal_comma = self.delimiter in (";", "\t") and _has_decimal_comma(head, self.delimiter)
        first = self._cells(head[0][1])
        self.has_header = not all(self._is_number(cell) for cell in first)
        self.skipped_lines = head[0][0] if self.has_header else head[0][0] - 1
        names = first if self.has_header else [str(k) for k in range(1, len(first) + 1)]
        commented = [] if self.has_header else self._cells(_comment_above(path, self.encoding, head[0][0]))
        if len(commented) == len(first) and all(commented):
            self.has_header, names = True, commented  # as numpy.savetxt writes its header
        super().__init__(path, names)
        repeated = next((name for name in names if name and names.count(name) > 1), None)
        if repeated is not None:
            raise RecordingError(
                f"{path}: row {head[0][0]}: the column name '{repeated}' stands twice, "
                f"wanted each name once; rename one"
            )

    def read(self, names: list[str]) -> list[np.ndarray]:
        chosen = [self.names.index(name) for name in names]
        if next(self._numbered(), None) is None:
            raise RecordingError(
                f"{self.path}: no row of numbers below the header; record or export it again"
            )
        try:
            table = np.loadtxt(
                [line for _, line in self._numbered()] if self.decimal_comma else self.path,
                delimiter=self.delimiter,
                skiprows=0 if self.decimal_comma else self.skipped_lines,
                usecols=chosen,
                ndmin=2,
                quotechar='"',
                encoding=self.encoding,
            )
        except ValueError as error:
            raise self._first_fault(chosen) or RecordingError(
                f"{self.path}: cannot be read as a table of numbers ({error})"
            ) from None
        return [np.ascontiguousarray(column) for column in table.T]

    def place(self, index: int) -> str:
        line = next(islice(self._numbered(), index, None), None)
        return f"row {line[0]}" if line else f"sample {index + 1}"

    def _offers(self, name: str) -> bool:
        if not self.has_header and not name.isdigit():
            raise RecordingError(
                f"{self.path}: has no header row, so no column '{name}'; "
                f"choose columns by number, 1 to {len(self.names)} (options input_column, output_column), "
                f"and time by its number (time_column) or by the sample rate (fs_hz)"
            )
        return False

    def _first_fault(self, chosen: list[int]) -> RecordingError | None:
        """The slow way through the file, once it is known that a cell is no number."""
        for row, line in self._numbered():
            cells = self._cells(line)
            for column in chosen:
                label = f"{self.path}: row {row}: column '{self.names[column]}'"
                if column >= len(cells) or not cells[column]:
                    return RecordingError(
                        f"{label}: found nothing, wanted a number (this row has {len(cells)} cells, "
                        f"the first one {len(self.names)}: {shortened(self.names)}); "
                        "complete the row or delete it"
                    )
                if not self._is_number(cells[column]):
                    return RecordingError(
                        f"{label}: found '{cells[column][:40]}', wanted a number; "
                        "correct the row or delete it"
                    )
        return None

    def _numbered(self) -> Iterator[tuple[int, str]]:
        """(line number in the file, line) of every row of numbers; a decimal comma is made a point."""
        for number, line in _rows(self.path, self.encoding):
            if number > self.skipped_lines:
                yield number, line.replace(",", ".") if self.decimal_comma else line

    def _cells(self, line: str) -> list[str]:
        cells = (
            line.split()
            if self.delimiter is None
            else next(csv.reader([line], delimiter=self.delimiter, skipinitialspace=True))
        )
        return [cell.strip() for cell in cells]

    def _is_number(self, cell: str) -> bool:
        try:
            float(cell.replace(",", ".") if self.decimal_comma else cell)
        except ValueError:
            return False
        return "_" not in cell  # Python reads 1_000 as a number, numpy does not


def _rows(path: str, encoding: str) -> Iterator[tuple[int, str]]:
    with open(path, encoding=encoding, errors="replace") as lines:
        for number, line in enumerate(lines, start=1):
            if line.strip() and not line.startswith("#"):
                yield number, line.rstrip("\r\n")


def _comment_above(path: str, encoding: str, row: int) -> str:
    if row == 1:
        return ""
    with open(path, encoding=encoding, errors="replace") as lines:
        above = next(islice(lines, row - 2, None)).strip()
    return above.removeprefix("#").strip() if above.startswith("#") else ""


def _encoding(path: str) -> str:
    """UTF-8, or Latin-1 where an instrument wrote a µ that is not UTF-8; judged by the head of the file."""
    with open(path, "rb") as file:
        head = file.read(1 << 16)
    if b"\0" in head:
        raise RecordingError(f"{path}: holds binary data, wanted text; give the file the suffix of its kind")
    try:
        head[: head.rfind(b"\n") + 1].decode("utf-8-sig")
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8-sig"


def _delimiter(line: str) -> str | None:
    return next((mark for mark in (";", "\t", ",") if mark in line), None)


def _has_decimal_comma(head: list[tuple[int, str]], delimiter: str) -> bool:
    numbers = [cell for _, line in head[1:] or head for cell in line.split(delimiter)]
    return any("," in cell for cell in numbers) and not any("." in cell for cell in numbers)
