"""A clock that jitters: whether it matters when, within its sample period, each reading was taken.

Where a loop reads just before it writes the next voltage, a late reading has seen some of that write already.
The response to a step of the voltage then depends on how late each reading is. On average it looks like a lag
of less than a sample, and neither a lag nor a delay as short can be told from it.
"""

from collections.abc import Sequence

import numpy as np

from torchpi.diagnosis.hypothesis import Fit
from torchpi.diagnosis.records import Record
from torchpi.diagnosis.search import Search
from torchpi.diagnosis.timing import lateness_s

SURE = 6.0
"""Standard errors from which a dependence on the lateness counts. How late a reading is has nothing to do
with the motion, so that its product with any model error has mean zero, and reaches so many once in 10⁹."""


def within_the_clock(search: Search, final: Fit) -> set[str]:
    """Return the names of the added effects that delay, if together they delay by less than a tick, and the
    residual depends on how late each reading was taken."""
    h = final.hypothesis
    names = {m.effect.name for m in h.members if m.effect.delays and m.effect.name not in search.given}
    if not names or not depends_on_lateness(search.chain.records, final.residuals):
        return set()
    bare = h
    for name in names:
        bare = bare.without(name)
    own_s = lateness_s(search.chain, h) - lateness_s(search.chain, bare)
    return names if own_s < search.chain.records[0].tick_s else set()


def depends_on_lateness(records: Sequence[Record], residuals: Sequence[np.ndarray]) -> bool:
    """Whether the part of residuals, (time,) each, µm, that goes with the last or next step of the voltage
    depends on how late each reading was taken."""
    sums, squares = np.zeros(2), np.zeros(2)
    for record, e in zip(records, residuals, strict=True):
        if record.late_s is None:
            continue
        late, u = record.late_s[record.train], record.u
        for k, step in enumerate((np.diff(u, prepend=u[0]), np.diff(u, append=u[-1]))):
            along = (late - late.mean()) * e[record.train] * step[record.train]
            sums[k] += along.sum()
            squares[k] += along @ along
    return bool((np.abs(sums) > SURE * np.sqrt(np.maximum(squares, 1e-300))).any())


def clock_notes(search: Search, final: Fit) -> tuple[str, ...]:
    """A sentence on what the clock hides, and how to record it."""
    if not within_the_clock(search, final):
        return ()
    tick_ms = 1e3 * search.chain.records[0].tick_s
    return (
        "The readings depend on how late their time stamps are: some were taken after the next voltage was "
        f"written. A lag or a delay of less than a sample ({tick_ms:.3g} ms) cannot be told from that; a "
        "recording whose readings are triggered at a fixed time after each voltage would show it.",
    )
