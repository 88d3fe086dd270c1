"""Cut records into consecutive windows; the compensator state is carried from one to the next."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from torch import Tensor

from torchpi.identification import InversePair
from torchpi.operators.motion import Motion


class Window(NamedTuple):
    """A stretch of one record.

    Attributes:
        motion: (1, time), µm, µm/s, µm/s².
        u: (1, time), V.
        counted: Slice of the samples that count in the loss; it may be empty.
        begins: Whether the record begins here, from the de-energised state.
    """

    motion: Motion
    u: Tensor
    counted: slice
    begins: bool


def windows(pairs: Sequence[InversePair], samples: int | None) -> Iterator[Window]:
    """Yield the records one after another, each whole or in windows of `samples` samples."""
    for pair in pairs:
        stop = pair.u.shape[1]
        length = samples or stop
        for start in range(0, stop, length):
            part = slice(start, min(start + length, stop))
            first = min(max(pair.counted.start, part.start), part.stop) - start
            last = min(max(pair.counted.stop, part.start), part.stop) - start
            motion = Motion(*(signal[:, part] for signal in pair.motion))
            yield Window(motion, pair.u[:, part], slice(first, max(first, last)), start == 0)
