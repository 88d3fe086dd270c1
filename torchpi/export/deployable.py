"""The interface of everything that can be exported."""

from typing import Protocol

from torchpi.control.step import CompensatorStream
from torchpi.operators.reference_filter import ReferenceFilter


class Deployable(Protocol):
    """A direct inverse, a corrected direct inverse, or any method that the paper compares with."""

    def stream(self, reference_filter: ReferenceFilter | None = None) -> CompensatorStream: ...
