"""Options for reading a recording from a file, the same in every command and in Python."""

from dataclasses import dataclass, fields, replace
from typing import Any, Literal

from torchpi.errors import ConfigError, is_number, kind_of

TIME_COLUMN, INPUT_COLUMN, OUTPUT_COLUMN = "time_s", "input_v", "output_um"
SIMULATED_COLUMN = "simulated_um"
FORCE_COLUMN = "force_n"


@dataclass(frozen=True)
class RecordingOptions:
    """Which columns of a file are read, in which units, and from where they count.

    A column of another name is found if only one column fits (`u [mV]`, `time_ms`, `output (nm)`), and its
    unit is read from the header.

    Args:
        time_column: Column of the time stamps, by name or by number from 1; null ignores time stamps.
        input_column: Column of the voltage, by name or by number from 1; in array files also name[:,0], in
            structs struct.field.
        output_column: Column of the displacement.
        fs_hz: Sample rate, Hz, or the name of a number in the file that states it; for files without time.
        resample: Accept recordings that are not sampled uniformly, or at a rate other than fs_hz: jittered
            rows are assigned to the ticks of the loop, others are interpolated.
        time_unit: s, ms, us, ns or min; by default as the column states, else s.
        input_unit: V, mV, kV or uV, or the number of volts per unit in the file; by default as the column
            states, else V.
        output_unit: um, nm, mm, m, pm, cm or angstrom, or the number of µm per unit in the file, negative
            if the sensor counts downwards; by default as the column states, else um.
        zero: Zero of the displacement: the sensor's own zero (recorded), or each record's first sample
            (first).
        skip_s: Start-up transient excluded from the errors, s: fit uses it to set the state, the other
            commands leave it out.

    Example:
        >>> import numpy as np
        >>> from torchpi import RecordingOptions, read_recording
        >>> k, names = np.arange(1000), "seconds,command,gauge"
        >>> np.savetxt("rig.csv", np.c_[k / 1000, k, 0.8 * k], delimiter=",", header=names, comments="")
        >>> columns = RecordingOptions("seconds", "command", "gauge", input_unit="mV", output_unit="nm")
        >>> read_recording("rig.csv", columns)
        Recording('rig', 1,000 samples at 1000 Hz, 1 s, u 0…0.999 V, y 0…0.7992 µm)
    """

    time_column: str | int | None = TIME_COLUMN
    input_column: str | int = INPUT_COLUMN
    output_column: str | int = OUTPUT_COLUMN
    fs_hz: float | str | None = None
    resample: bool = False
    time_unit: str | None = None
    input_unit: float | str | None = None
    output_unit: float | str | None = None
    zero: Literal["recorded", "first"] = "recorded"
    skip_s: float = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.resample, bool):
            raise ConfigError(f"resample: found {self.resample!r}, expected true or false")
        if self.zero not in ("recorded", "first"):
            raise ConfigError(f"zero: found '{self.zero}', expected recorded or first")
        if not (is_number(self.skip_s) and 0 <= self.skip_s < float("inf")):
            raise ConfigError(f"skip_s: found {self.skip_s!r}, expected a time in s that is not negative")

    @classmethod
    def of(cls, options: "RecordingOptions | None", changes: dict[str, Any]) -> "RecordingOptions":
        """Return the given options, or the defaults if None, with single options changed.

        Raises:
            ConfigError: `options` has another type, or an option in `changes` does not exist.
        """
        if not isinstance(options, RecordingOptions | None):
            raise ConfigError(
                f"options: found {kind_of(options)}, expected RecordingOptions; pass single options by name, "
                "such as fs_hz=1000"
            )
        return (options or cls()).with_changes(**changes)

    def with_changes(self, **changes: Any) -> "RecordingOptions":
        """Return the same options with these changes.

        Raises:
            ConfigError: An option that does not exist.
        """
        known = [field.name for field in fields(self)]
        if unknown := [name for name in changes if name not in known]:
            raise ConfigError(f"found the option '{unknown[0]}', expected one of {', '.join(known)}")
        return replace(self, **changes)

    def as_arguments(self, prefix: str = "--") -> list[str]:
        """Return the command-line arguments of the options that differ from their defaults."""
        arguments = []
        for field in fields(self):
            value = getattr(self, field.name)
            if value != field.default:
                text = _as_text(value)
                arguments += (
                    [f"{prefix}{field.name}={text}"] if text[:1] == "-" else [f"{prefix}{field.name}", text]
                )
        return arguments


def _as_text(value: object) -> str:
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return "null" if value is None else str(value).lower() if isinstance(value, bool) else str(value)
