"""Which recordings something was made from: a hash that a compensator and a stage both carry."""

import hashlib
import re
from collections.abc import Iterable

from torchpi.recordings.recording import Recording


def recordings_sha256(recordings: Iterable[Recording]) -> str:
    """Hash of a set of recordings by their content, whatever their order, names and places.

    Args:
        recordings: As they were read; one that was not read from a file counts by its voltage and
            displacement.
    """
    each = sorted(recording.sha256 or _of_samples(recording) for recording in recordings)
    return hashlib.sha256("\n".join(each).encode()).hexdigest()


def is_sha256(value: object) -> bool:
    """Whether a value is such a hash: 64 hexadecimal digits."""
    return isinstance(value, str) and re.fullmatch(r"[0-9a-f]{64}", value) is not None


def _of_samples(recording: Recording) -> str:
    return hashlib.sha256(recording.u.tobytes() + recording.y.tobytes()).hexdigest()
