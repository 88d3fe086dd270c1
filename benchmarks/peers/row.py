"""One line of the comparison."""

from dataclasses import dataclass

from task import Peer


@dataclass(frozen=True)
class Row:
    """Results of one peer.

    Attributes:
        peer: The peer.
        samples: Number of samples of the record that was fitted.
        fit_s: Median processor time to fit, without compilation.
        compile_s: Time of compilation; None where nothing is compiled.
        rms_v: Held-out rms error, V.
        max_v: Largest held-out error, V.
        range_v: Range of the held-out voltage.
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
