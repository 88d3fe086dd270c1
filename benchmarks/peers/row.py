"""One line of the comparison."""

from dataclasses import dataclass

from task import Peer


@dataclass(frozen=True)
class Row:
    """What one peer achieved.

    Attributes:
        peer: Which.
        samples: Of the record that was fitted.
        fit_s: Median time of the processor to fit, without compilation.
        compile_s: Compilation; None where nothing is compiled.
        rms_v: Held-out error, V.
        max_v: Likewise, the largest.
        range_v: Of the held-out voltage.
        step_us: Median time of a streamed step from Python; None where there is none.
    """

    peer: Peer
    samples: int
    fit_s: float
    compile_s: float | None
    rms_v: float
    max_v: float
    range_v: float
    step_us: float | None

    @property
    def whole_s(self) -> float:
        return self.fit_s + (self.compile_s or 0.0)
