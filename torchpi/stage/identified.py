"""What a stage that was identified carries of its origin."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import combinations
from typing import Any

from torchpi.errors import StageError, is_number
from torchpi.recordings.identity import combined_sha256, each_sha256, is_sha256
from torchpi.recordings.recording import Recording

MOST_EACH = 50  # recordings of which all sets without one or two are compared
MOST_HELD_OUT = 2


@dataclass(frozen=True)
class Identified:
    """The recordings that a stage was identified from, and its error on one that it was not.

    Attributes:
        recordings_sha256: `recordings_sha256` of those recordings; a compensator of the same ones carries it.
        heldout: The recording that it is judged on.
        heldout_rms_um: Rms of the free-run simulation's error there, about its mean (the sensor's zero), µm.
        heldout_max_um: Its largest, µm.
        each_sha256: Hash of each of those recordings, where a compensator may be trained on fewer of them: a
            diagnosis takes all, and a training holds some out.
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
        """From recordings of which a part, described in `heldout`, was not fitted."""
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
        """The inverse of `plain`.

        Raises:
            StageError: Another field, or a value of another kind.
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
        """Its fields, as files keep them."""
        values = asdict(self) | {"each_sha256": list(self.each_sha256)}
        return values if self.each_sha256 else {k: v for k, v in values.items() if k != "each_sha256"}

    def has(self, sha256: str) -> bool:
        """Whether this is the hash of its recordings or, where each is known, of all but one or two."""
        if sha256 == self.recordings_sha256:
            return True
        return any(
            sha256 == combined_sha256(kept)
            for left_out in range(1, min(MOST_HELD_OUT, len(self.each_sha256) - 1) + 1)
            for kept in combinations(self.each_sha256, len(self.each_sha256) - left_out)
        )
