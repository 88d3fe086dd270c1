"""Identity of a set of recordings: whether they share a sample rate, and the hash stored in their models."""

import hashlib
import re
from collections.abc import Iterable, Sequence

import numpy as np

from torchpi.errors import RecordingError
from torchpi.recordings.recording import Recording, samples_sha256


def recordings_sha256(recordings: Iterable[Recording]) -> str:
    """Return the hash of a set of recordings by content, independent of their order, names and paths.

    Args:
        recordings: The recordings as read; one that was not read from a file is hashed by its voltage and
            displacement.
    """
    return combined_sha256(each_sha256(recordings))


def each_sha256(recordings: Iterable[Recording]) -> list[str]:
    """Return the hash of each recording by its content, sorted by hash."""
    return sorted(recording.sha256 or samples_sha256(recording.u, recording.y) for recording in recordings)


def combined_sha256(each: Iterable[str]) -> str:
    """Return the `recordings_sha256` of recordings with these hashes."""
    return hashlib.sha256("\n".join(sorted(each)).encode()).hexdigest()


def is_sha256(value: object) -> bool:
    """Whether a value is a SHA-256 hash: 64 hexadecimal digits."""
    return isinstance(value, str) and re.fullmatch(r"[0-9a-f]{64}", value) is not None


def check_one_rate(recordings: Sequence[Recording]) -> None:
    """Raise `RecordingError` unless all recordings have the same sample rate."""
    first = recordings[0]
    for other in recordings[1:]:
        if not np.isclose(other.fs_hz, first.fs_hz, rtol=1e-6):
            raise RecordingError(
                f"{other.source or other.name}: sampled at {other.fs_hz:g} Hz, "
                f"but {first.source or first.name} at {first.fs_hz:g} Hz; "
                "expected one rate: train on each rate separately, or resample"
            )
