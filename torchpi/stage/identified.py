"""The record of its origin that an identified stage carries."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import combinations
from typing import Any

from torchpi.errors import StageError, is_number
from torchpi.recordings.identity import combined_sha256, each_sha256, is_sha256
from torchpi.recordings.recording import Recording

MOST_EACH = 50  # most recordings for which all subsets without one or two are compared
MOST_HELD_OUT = 2


@dataclass(frozen=True)
class Identified:
    """The recordings that a stage was identified from, and its error on a held-out one.

    Attributes:
        recordings_sha256: `recordings_sha256` of those recordings; a compensator of the same ones carries it.
        heldout: The held-out recording on which the stage is judged.
        heldout_rms_um: Rms of the free-run simulation's error there, about its mean (the sensor's zero), µm.
        heldout_max_um: Largest error there, µm.
        each_sha256: Hash of each of those recordings, because a compensator may be trained on fewer of them:
            a diagnosis uses all, while a training holds some out.
    """

    recordings_sha256: str
    heldout: str
    heldout_rms_um: float
    heldout_max_um: float
    each_sha256: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, recordings: Sequence[Recording], heldout: str, heldout_rms_um: float, heldout_max_um: float
    ) -> "Identified":
        """Create the record from recordings of which a part, described in `heldout`, was not fitted."""
        each = each_sha256(recordings)
        return cls(
            combined_sha256(each),
            heldout,
            heldout_rms_um,
            heldout_max_um,
            tuple(each) if len(each) <= MOST_EACH else (),
        )

    @classmethod
    def from_plain(cls, values: Mapping[str, Any]) -> "Identified":
        """Create the record from its fields: the inverse of `plain`.

        Raises:
            StageError: An unknown or missing field, or a value of the wrong kind.
        """
        names = [field.name for field in fields(cls)]
        if not isinstance(values, Mapping) or set(values) | {"each_sha256"} != set(names):
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
            if not is_number(value) or not 0 <= value < math.inf:
                raise StageError(f"identified.{name}: found {value!r}, expected a non-negative number")
        each = values.get("each_sha256", ())
        if not isinstance(each, list | tuple) or len(each) > MOST_EACH or not all(map(is_sha256, each)):
            raise StageError(
                f"identified.each_sha256: found {str(each)[:80]!r}, "
                f"expected a list of at most {MOST_EACH}, 64 hexadecimal digits each"
            )
        return cls(**{**values, "each_sha256": tuple(each)})

    def plain(self) -> dict[str, Any]:
        """Return the fields as files store them."""
        values = asdict(self) | {"each_sha256": list(self.each_sha256)}
        return values if self.each_sha256 else {k: v for k, v in values.items() if k != "each_sha256"}

    def has(self, sha256: str) -> bool:
        """Whether this is the hash of its recordings or, if each hash is known, of all but one or two."""
        if sha256 == self.recordings_sha256:
            return True
        return any(
            sha256 == combined_sha256(kept)
            for left_out in range(1, min(MOST_HELD_OUT, len(self.each_sha256) - 1) + 1)
            for kept in combinations(self.each_sha256, len(self.each_sha256) - left_out)
        )
