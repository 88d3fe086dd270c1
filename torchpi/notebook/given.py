"""Recordings as a notebook gives them: one, or several in whatever holds them."""

from collections.abc import Iterable

from torchpi.errors import RecordingError, kind_of
from torchpi.recordings.recording import Recording


def given_recordings(recordings: Recording | Iterable[Recording]) -> list[Recording]:
    """All of them.

    Raises:
        RecordingError: Something else; names what was found, and at which index.
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
