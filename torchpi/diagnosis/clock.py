"""A clock that jitters: whether it matters when, within its sample period, each reading was taken.

Where a loop reads just before it writes the next voltage, a late reading has seen some of that write already:
y(k) = x(k) + c l(k) [x(k+1) - x(k)], with the displacement x at the ticks, the lateness l of each reading and
one number c, 1/T for a displacement that moves evenly and more for one that follows each write at once. The
time stamps tell l, so c can be estimated and the readings brought back to their ticks. What all readings have
seen alike looks like a lag of less than a sample, and neither a lag nor a delay as short can be told from it.
"""

from collections.abc import Sequence

import numpy as np

from torchpi.diagnosis.hypothesis import Fit
from torchpi.diagnosis.records import Record
from torchpi.diagnosis.search import Search
from torchpi.diagnosis.timing import lateness_s

SURE = 5.0
"""Standard errors from which a dependence on the lateness counts. How late a reading is has nothing to do
with the motion, so that its product with any model error has mean zero: it reaches so many once in 10⁶."""
ON_TIME = 0.001
"""Share of the readings that count as taken at their ticks: a single stray time stamp must move no others."""
MOST_SEEN = 0.5
"""Share of the next step from which a reading does not count: it says more of the next tick than of its."""


def seen_early(records: Sequence[Record], residuals: Sequence[np.ndarray]) -> list[np.ndarray] | None:
    """Return the share of the next step that each reading has already seen, (time,) for each recording; None
    if the residuals, (time,) each, µm, of a fit do not depend on how late the readings are."""
    if not depends_on_lateness(records, residuals):
        return None
    late = [np.zeros(len(r.u)) if r.late_s is None else later_than_usual(r.late_s) for r in records]
    products, steps, errors = [], [], []
    for record, late_s, e in zip(records, late, residuals, strict=True):
        if record.late_s is not None:
            x = record.y - e
            step = np.diff(x, append=x[-1:])[record.train]
            products.append(late_s[record.train] * step)
            steps.append(step)
            errors.append(e[record.train])
    columns = np.stack([np.concatenate(products), np.concatenate(steps)], axis=1)
    # The second number is what all readings have seen alike, and any lag.
    (per_s, _), *_ = np.linalg.lstsq(columns, np.concatenate(errors), rcond=None)
    if per_s <= 0:
        return None
    return [per_s * late_s for late_s in late]


def later_than_usual(late_s: np.ndarray) -> np.ndarray:
    """(time,), s: how much later each reading was taken than the earliest, but for stray time stamps."""
    later: np.ndarray = np.maximum(late_s - np.quantile(late_s, ON_TIME), 0.0)
    return later


def at_their_ticks(
    y: np.ndarray,  # (time,), µm
    seen: np.ndarray,  # (time,)
) -> np.ndarray:  # (time,), µm
    """Return what the readings would be without the share of the next step that each has seen: the solution
    of y(k) = x(k) + s(k) [x(k+1) - x(k)]."""
    x, share = y.astype(np.float64), np.minimum(seen, MOST_SEEN)
    for k in range(len(x) - 2, -1, -1):
        x[k] = (x[k] - share[k] * x[k + 1]) / (1.0 - share[k])
    return x


def within_the_clock(search: Search, final: Fit) -> set[str]:
    """Return the names of the added effects that delay, if together they delay by less than a tick, and it
    matters how late each reading was taken."""
    h = final.hypothesis
    names = {m.effect.name for m in h.members if m.effect.delays and m.effect.name not in search.given}
    if not names or not (search.brought_back or depends_on_lateness(search.chain.records, final.residuals)):
        return set()
    bare = h
    for name in names:
        bare = bare.without(name)
    own_s = lateness_s(search.chain, h) - lateness_s(search.chain, bare)
    return names if own_s < search.chain.records[0].tick_s else set()


def depends_on_lateness(records: Sequence[Record], residuals: Sequence[np.ndarray]) -> bool:
    """Whether the part of residuals, (time,) each, µm, that goes with the last or next step of the voltage
    depends on how late each reading was taken."""
    found: list[list[float]] = [[], []]
    for record, e in zip(records, residuals, strict=True):
        if record.late_s is None:
            continue
        late, left, u = record.late_s[record.train], e[record.train], record.u
        for k, step in enumerate((np.diff(u, prepend=u[0]), np.diff(u, append=u[-1]))):
            steps = step[record.train]
            alike = steps @ left / max(float(steps @ steps), 1e-300)
            # The sign alone: of rare large steps each would count a thousand times as much as a small one.
            along = (late - late.mean()) * (left - alike * steps) * np.sign(steps)
            found[k].append(float(along.sum() / np.sqrt(max(float(along @ along), 1e-300))))
    # Each recording counts the same (Stouffer et al., 1949): the steps of one may be a thousand times larger.
    return any(abs(sum(one)) > SURE * np.sqrt(len(one)) for one in found if one)


def clock_notes(search: Search, final: Fit) -> tuple[str, ...]:
    """Sentences on late readings, on what the clock hides, and how to record it."""
    found = []
    why = "The readings depend on how late their time stamps are: "
    if search.brought_back:
        found.append(
            f"{why}the latest have seen {100 * search.brought_back:.2g} % of the response to the next "
            "voltage. They were brought back to their ticks; the errors stated here are those of the "
            "corrected readings."
        )
    if within_the_clock(search, final):
        tick_ms = 1e3 * search.chain.records[0].tick_s
        found.append(
            ("" if found else f"{why}some were taken after the next voltage was written. ")
            + f"A lag or a delay of less than a sample ({tick_ms:.3g} ms) cannot be told from late readings; "
            "a recording whose readings are triggered at a fixed time after each voltage would show it."
        )
    return tuple(found)
