"""What a stage that was identified carries of its origin."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from torchpi.errors import StageError
from torchpi.recordings.identity import is_sha256


@dataclass(frozen=True)
class Identified:
    """The recordings that a stage was identified from, and its error on one that it was not.

    Attributes:
        recordings_sha256: `recordings_sha256` of those recordings; a compensator of the same ones carries it.
        heldout: The recording that it is judged on.
        heldout_rms_um: Rms of the free-run simulation's error there, about its mean (the sensor's zero), µm.
        heldout_max_um: Its largest, µm.
    """

    recordings_sha256: str
    heldout: str
    heldout_rms_um: float
    heldout_max_um: float

    @classmethod
    def from_plain(cls, values: Mapping[str, Any]) -> "Identified":
        """The inverse of `plain`.

        Raises:
            StageError: Another field, or a value of another kind.
        """
        names = [field.name for field in fields(cls)]
        if not isinstance(values, Mapping) or set(values) != set(names):
            found = sorted(values) if isinstance(values, Mapping) else type(values).__name__
            raise StageError(f"identified: found {found}, expected {', '.join(names)}")
        if not is_sha256(values["recordings_sha256"]):
            raise StageError(
                f"identified.recordings_sha256: found {values['recordings_sha256']!r}, "
                "expected 64 hexadecimal digits"
            )
        if not isinstance(values["heldout"], str):
            raise StageError(f"identified.heldout: found {values['heldout']!r}, expected a name")
        for name in ("heldout_rms_um", "heldout_max_um"):
            value = values[name]
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
                raise StageError(f"identified.{name}: found {value!r}, expected a non-negative number")
        return cls(**values)

    def plain(self) -> dict[str, Any]:
        """Its fields, as files keep them."""
        return asdict(self)
