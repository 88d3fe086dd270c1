"""Recordings given in a notebook: a single one, or several in any iterable."""

from collections.abc import Iterable

from torchpi.errors import RecordingError, kind_of
from torchpi.recordings.recording import Recording


def given_recordings(recordings: Recording | Iterable[Recording]) -> list[Recording]:
    """Return the given recordings as a list.

    Raises:
        RecordingError: Something else was given; the message names its type and index.
    """
    expected = "expected a Recording: Recording.from_arrays(t, u, y) makes one"
    if isinstance(recordings, Recording):
        return [recordings]
    if not isinstance(recordings, Iterable) or isinstance(recordings, str) or hasattr(recordings, "shape"):
        raise RecordingError(f"recordings: found {kind_of(recordings)}, {expected}")
    given = list(recordings)
    for k, recording in enumerate(given):
        if not isinstance(recording, Recording):
            raise RecordingError(f"recordings: found {type(recording).__name__} at index {k}, {expected}")
    return given
