"""Reader of LabVIEW measurement text (.lvm): a table below headers with the sample period and the units."""

from itertools import islice

import numpy as np

from torchpi.recordings.readers.header import stated_unit
from torchpi.recordings.readers.text import SNIFFED_LINES, TextSource, text_encoding

END = "***End_of_Header***"


def open_file(path: str) -> "LvmSource":
    return LvmSource(path)


class LvmSource(TextSource):
    """The table below the headers."""

    def __init__(self, path: str) -> None:
        with open(path, encoding=text_encoding(path), errors="replace") as lines:
            head = [line.rstrip("\r\n") for line in islice(lines, SNIFFED_LINES)]
        ends = [number for number, line in enumerate(head, start=1) if line.startswith(END)]
        super().__init__(path, skip_lines=ends[-1] if ends else 0)
        settings: dict[str, list[str]] = {}
        for line in filter(str.strip, head[: ends[-1]] if ends else []):
            key, *values = line.replace(",", ".").split("\t" if "\t" in line else None)
            settings[key] = [value.strip() for value in values if value.strip()]
        signals = [name for name in self.names if name not in ("", "X_Value", "Comment")]
        for name, unit in zip(signals, settings.get("Y_Unit_Label", []), strict=False):
            if (stated := stated_unit(unit)) is not None:
                self.units[name] = stated
        self.period_s = _number(settings.get("Delta_X", []))
        self.has_times = self.period_s is not None and settings.get("X_Columns") == ["No"]

    def times(self, name: str) -> np.ndarray | None:
        if not self.has_times or self.period_s is None:
            return None
        return np.arange(sum(1 for _ in self.numbered())) * self.period_s


def _number(values: list[str]) -> float | None:
    try:
        return float(values[0])
    except (IndexError, ValueError):
        return None
