"""Names and units of columns, as rigs write them: `u [mV]`, `output (nm)`, `time_ms`, or a row of units.

The column of the time, the input or the output is guessed from names and units only if exactly one column
fits; if several do, the user must choose.
"""

import re
import unicodedata
from collections.abc import Iterable
from typing import Literal

Role = Literal["time", "input", "output"]

# (times, by): a value in our unit is value · times / by. A pair is kept instead of a factor because dividing
# by 1000 rounds once, but multiplying by 0.001 twice.
UNITS: dict[Role, dict[str, tuple[float, float]]] = {
    "time": {"s": (1, 1), "ms": (1, 1000), "us": (1, 1_000_000), "ns": (1, 1_000_000_000), "min": (60, 1)},
    "input": {"V": (1, 1), "mV": (1, 1000), "kV": (1000, 1), "uV": (1, 1_000_000)},
    "output": {
        "um": (1, 1),
        "nm": (1, 1000),
        "mm": (1000, 1),
        "m": (1_000_000, 1),
        "pm": (1, 1_000_000),
        "cm": (10_000, 1),
        "angstrom": (1, 10_000),
    },
}
ALIASES = {
    "v": "V", "volt": "V", "volts": "V", "mv": "mV", "kv": "kV", "uv": "uV", "micron": "um", "microns": "um",
    "sec": "s", "second": "s", "seconds": "s", "minutes": "min", "msec": "ms", "usec": "us",
    "milliseconds": "ms", "microseconds": "us", "millivolts": "mV", "micrometer": "um", "micrometers": "um",
    "micrometre": "um", "micrometres": "um", "nanometer": "nm", "nanometers": "nm", "nanometre": "nm",
    "nanometres": "nm", "millimeters": "mm", "millimetres": "mm", "meters": "m", "metres": "m",
    "Å": "angstrom", "angstrom": "angstrom", "angstroms": "angstrom", "ångström": "angstrom",
}  # fmt: skip
STEMS: dict[Role, frozenset[str]] = {
    "time": frozenset({"time", "t", "timestamp", "time_stamp", "timestamps", "datetime", "x_value"}),
    "input": frozenset({"input", "in", "u", "voltage", "command", "cmd", "drive", "v_in", "vin"}),
    "output": frozenset({"output", "out", "y", "displacement", "position", "disp", "pos", "stroke"}),
}
# Lower-case words that appear in brackets but are not units. `in` is left out, as it may mean inches.
DESCRIPTIONS = frozenset().union(*STEMS.values()) - {"in"} | {
    "raw", "filtered", "measured", "meas", "actual", "desired", "set", "setpoint", "target", "reference",
    "ref", "sensor", "monitor", "mon", "feedback", "open", "closed", "left", "right", "x", "y", "z", "utc",
    "gmt", "local", "iso", "none", "unknown",
}  # fmt: skip
LONGEST_NAME = 200  # characters of a name that is parsed: the patterns below take quadratic time
_BRACKETED = re.compile(r"(?P<stem>.*?)\s*[\[({]\s*(?P<unit>[^\])}]*?)\s*[\])}]\s*")
_UNIT = re.compile(r"[./·*]*(?:[^\W\d_]|[%°])(?:[^\W\d_]|[./·*%°])*")  # letters, and signs that combine units
_SUFFIXED = re.compile(r"(?P<stem>.+?)(?:\s*/\s*|_|\s+|\s*,\s*)(?P<unit>[A-Za-zµμ]+)")
# Names in torchpi's own style, in which the last part is the unit.
_OWN = re.compile(r"(?P<stem>time|input|output)(?:_|\s*[/,]\s*)(?P<unit>.+)", re.IGNORECASE)

SIMULATED = "simulated"
"""Start of the name of a column with a simulator's output for the voltage."""


def known_unit(text: str) -> str | None:
    """Return the unit's plain name (`um` for µm), or None if it is not a unit of time, voltage or length."""
    plain = unicodedata.normalize("NFC", text.strip()).replace("µ", "u").replace("μ", "u")
    plain = ALIASES.get(plain.lower() if plain[1:].islower() else plain, plain)
    return plain if any(plain in units for units in UNITS.values()) else None


def stated_unit(text: str) -> str | None:
    """Return the unit that a file states in brackets or beside a name, known or not; None if there is none.

    A channel (`CH1`), a number or a description (`raw`) is not a unit.
    """
    plain = text.strip()
    is_unit = _UNIT.fullmatch(plain) and plain.lower() not in DESCRIPTIONS
    return known_unit(plain) or (plain if is_unit else None)


def role_of_unit(unit: str) -> Role | None:
    """Return the role measured in this unit, which `stated_unit` returned; None if the unit is unknown."""
    return next((role for role, units in UNITS.items() if unit in units), None)


def stem_and_unit(name: str) -> tuple[str, str | None]:
    """Split `u [mV]`, `u (mV)`, `u / mV` or `u_mV` into (`u`, `mV`); without a unit, (name, None).

    In brackets, and after `time`, `input` and `output`, the unit may be an unknown one.
    """
    if len(name) > LONGEST_NAME:
        return name, None
    bracketed = _BRACKETED.fullmatch(name)
    if bracketed:
        return _plain(bracketed["stem"]), stated_unit(bracketed["unit"])
    suffixed = _SUFFIXED.fullmatch(name)
    unit = known_unit(suffixed["unit"]) if suffixed else None
    if suffixed is None or unit is None:
        own = _OWN.fullmatch(name)
        stated = stated_unit(own["unit"]) if own and _plain(name) not in STEMS["time"] else None
        return (_plain(own["stem"]), stated) if own and stated else (_plain(name), None)
    stem = _plain(suffixed["stem"])
    # `y_m` more likely means "y, measured" than metres; `output_m` is in metres.
    if len(suffixed["unit"]) == 1 and (len(stem) == 1 or not any(stem in stems for stems in STEMS.values())):
        return _plain(name), None
    return stem, unit


def columns_for(role: Role, units: Iterable[tuple[str, str | None]]) -> list[str]:
    """Return the columns that may have this role, from pairs of name and stated unit: by name, else by unit.

    A column in an unknown unit counts only if no other column has such a name.
    """
    of_unit, of_name, of_unknown_unit = list[str](), list[str](), list[str]()
    for name, unit in units:
        stem = stem_and_unit(name)[0]
        measured = None if unit is None else role_of_unit(unit)
        if name.startswith("aux_") or stem == SIMULATED or measured not in (role, None):
            continue
        if stem in STEMS[role]:
            (of_unknown_unit if unit is not None and measured is None else of_name).append(name)
        if measured is not None:
            of_unit.append(name)
    return of_name or of_unknown_unit or of_unit


def _plain(stem: str) -> str:
    return re.sub(r"\W+", "_", stem.strip().lower()).strip("_")
