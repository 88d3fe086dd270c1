"""Time stamps of ISO 8601, `2024-05-01T12:00:00.0001Z` or the time of day alone, in s from the first."""

import re

import numpy as np

# Years 1700 to 2199, which fit into 64-bit nanoseconds.
_STAMP = re.compile(
    r"(?:(?P<date>(?:1[7-9]|2[01])\d\d-\d\d-\d\d)[T ])?(?P<time>\d\d:\d\d:\d\d(?:[.,]\d{1,9})?)"
    r"\s*(?P<zone>Z|[+-]\d\d:?\d\d)?"
)


def is_stamp(cell: str) -> bool:
    """Whether this cell is an ISO 8601 time stamp of an existing date and time."""
    try:
        _moment(cell)
    except ValueError:
        return False
    return True


def seconds_of(cells: np.ndarray) -> np.ndarray:
    """Return seconds from the first stamp (time,), exact to a nanosecond.

    Raises:
        ValueError: a cell is not a time stamp, or its date does not exist.
    """
    moments = np.array([_moment(str(cell)) for cell in cells], dtype="datetime64[ns]")
    return np.asarray((moments - moments[0]) / np.timedelta64(1, "s"), dtype=np.float64)


def _moment(cell: str) -> np.datetime64:
    match = _STAMP.fullmatch(cell.strip().strip('"'))
    if match is None:
        raise ValueError(f"'{cell}' is not a time stamp")
    moment = np.datetime64(f"{match['date'] or '1970-01-01'}T{match['time'].replace(',', '.')}", "ns")
    if match["zone"] in (None, "Z"):
        return moment
    minutes = 60 * int(match["zone"][1:3]) + int(match["zone"][-2:])
    return moment - np.timedelta64(minutes if match["zone"][0] == "+" else -minutes, "m")
