"""A record folded into lanes, so that one record fills the vector unit and all threads.

A play needs its previous state, so a record seems sequential. But a play is a clamp of its state, and clamps
compose to clamps: looking back from any sample, the composed clamp [low, high] soon closes, and then the
state there is known without the earlier samples. Every record is therefore cut into stretches of equal
length, the state at the start of each is found first, and then all stretches advance in parallel.

`LANES` stretches form a group, the unit of work of a thread. Within a group the stretches are interleaved:
sample s of lane l has index s LANES + l, and the previous state of a play is LANES places back. All loops are
thus flat loops over such indices, which the compiler vectorises. `STEPS` samples of all lanes form a tile,
which stays in the first-level cache.

Stretches that reach beyond the record repeat its last sample, which leaves every state unchanged. How a
record is cut depends on its length alone, so that results have the same bits for any number of threads.
"""

import numpy as np

from torchpi.operators.compiled import njit, njit_sum
from torchpi.operators.play_equation import play

LANES = 32
STEPS = 32
TILE = LANES * STEPS

_play = njit(play)


def fold_shape(samples: int) -> tuple[int, int]:
    """Return the number of groups of a record with so many samples, and the samples per lane."""
    groups = min(max(samples // (48 * TILE), 1), 64)
    return groups, -(-samples // (groups * LANES))


@njit
def fold(x: np.ndarray, group: int, first: int, last: int, length: int, folded: np.ndarray) -> None:
    """Copy steps `first` to `last` of every lane out of a record (time,)."""
    for step in range(first, last):
        for lane in range(LANES):
            t = (group * LANES + lane) * length + step
            folded[(step - first) * LANES + lane] = x[min(t, len(x) - 1)]


@njit
def unfold(folded: np.ndarray, group: int, first: int, last: int, length: int, x: np.ndarray) -> None:
    """The inverse of `fold`."""
    for step in range(first, last):
        for lane in range(LANES):
            t = (group * LANES + lane) * length + step
            if t < len(x):
                x[t] = folded[(step - first) * LANES + lane]


@njit
def extent(x: np.ndarray, least: np.ndarray, most: np.ndarray) -> None:
    """Find the least and greatest value in the stretch of each lane."""
    least[:] = np.inf
    most[:] = -np.inf
    for start in range(0, len(x), LANES):
        row = x[start : start + LANES]
        for lane in range(LANES):
            least[lane] = min(least[lane], row[lane])
            most[lane] = max(most[lane], row[lane])


@njit
def compose(
    x: np.ndarray,
    r: float,
    least: np.ndarray,
    most: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    lows: np.ndarray,
    highs: np.ndarray,
) -> None:
    """Compute the clamp that a play applies to its state over a whole stretch, for each lane: [low, high].

    Where x varies less than the width of the play, all clamps overlap and compose to their intersection.
    Elsewhere, walk back from the end until the clamp closes: low = high is then the state at the end.
    `least` and `most` come from `extent`; `lows` and `highs` are scratch space.
    """
    lows[:LANES] = -np.inf
    highs[:LANES] = np.inf
    end = len(x)
    while True:
        closed = 0
        for lane in range(LANES):
            closed += (most[lane] - r <= least[lane] + r) | (lows[lane] == highs[lane])
        if closed == LANES or end == 0:
            break
        tile = x[max(end - TILE, 0) : end]
        lows[len(tile) : len(tile) + LANES] = lows[:LANES].copy()
        highs[len(tile) : len(tile) + LANES] = highs[:LANES].copy()
        for q in range(len(tile) - 1, -1, -1):
            # The earlier clamp passes through the later one.
            lows[q] = max(lows[q + LANES], min(highs[q + LANES], tile[q] - r))
            highs[q] = max(lows[q + LANES], min(highs[q + LANES], tile[q] + r))
        end -= len(tile)
    for lane in range(LANES):
        narrow = most[lane] - r <= least[lane] + r
        low[lane] = most[lane] - r if narrow else lows[lane]
        high[lane] = least[lane] + r if narrow else highs[lane]


@njit
def chain(low: np.ndarray, high: np.ndarray, h0: np.ndarray, starts: np.ndarray, final: np.ndarray) -> None:
    """Compute the states at the start of every stretch, and after the last one, from the composed clamps.

    `low`, `high` and `starts` are (batch, groups, plays, lanes), `h0` and `final` (batch, plays).
    """
    batch, groups, plays, lanes = starts.shape
    for row in range(batch):
        for i in range(plays):
            h = h0[row, i]
            for group in range(groups):
                for lane in range(lanes):
                    starts[row, group, i, lane] = h
                    h = max(low[row, group, i, lane], min(high[row, group, i, lane], h))
            final[row, i] = h


@njit
def advance(x: np.ndarray, r: float, h: np.ndarray, count: int) -> None:
    """Compute the states of one play over a tile of `count` samples; `h` begins with those before it."""
    for q in range(count):
        h[q + LANES] = _play(x[q], r, h[q])


@njit
def advance_sum(x: np.ndarray, r: float, h: np.ndarray, w: np.ndarray, count: int, total: np.ndarray) -> None:
    """Like `advance`, but also add the states weighted by `w` to `total`, in one pass over the tile."""
    for q in range(count):
        h[q + LANES] = _play(x[q], r, h[q])
        total[q] += w[q] * h[q + LANES]


@njit
def advance_linear_sum(
    x: np.ndarray,
    r: float,
    h: np.ndarray,
    a: float,
    b: float,
    rate: np.ndarray,
    count: int,
    total: np.ndarray,
) -> None:
    """`advance_sum` with the weights a + b ẏ of eq. 7, which then need no pass of their own."""
    for q in range(count):
        h[q + LANES] = _play(x[q], r, h[q])
        total[q] += (a + b * rate[q]) * h[q + LANES]


@njit_sum
def threshold_gradient(
    gh: np.ndarray, x: np.ndarray, h: np.ndarray, waiting: np.ndarray, count: int
) -> float:
    """Sum what `land` assigned to pushing samples: + where the upper edge pushed, - where the lower did."""
    total: float = x.dtype.type(0)
    for q in range(count):
        landed = gh[q] + waiting[q + LANES] - waiting[q]
        total += landed if h[q] > x[q] else -landed
    return total


@njit
def expect_pushes(r: float, h: np.ndarray, least: np.ndarray, most: np.ndarray, latest: np.ndarray) -> None:
    """Mark in `latest` the lanes where some sample pushes the play, which enters with the states `h`."""
    for lane in range(LANES):
        rests = most[lane] - r < h[lane] and h[lane] < least[lane] + r
        latest[lane] = 0 if rests else np.inf


@njit
def note_latest(x: np.ndarray, r: float, h: np.ndarray, count: int, begin: int, latest: np.ndarray) -> None:
    """Note the last push in each marked lane: its step + 1, negative if the lower edge pushed.

    To be called for tiles from the last to the first; `begin` is the first step of the tile.
    """
    for lane in range(LANES):
        if latest[lane] != np.inf:
            continue
        # Lane by lane: most lanes stop after a few steps, but a joint loop would run until the last one does.
        for q in range(count - LANES + lane, -1, -LANES):
            if not (x[q] - r < h[q] < x[q] + r):
                step = begin + q // LANES + 1
                latest[lane] = step if h[q] > x[q] - r else -step
                break


@njit
def hand_over(
    left: np.ndarray, latest: np.ndarray, length: int, gx: np.ndarray, gr: np.ndarray, gh: np.ndarray
) -> None:
    """Add the gradient that a stretch leaves at its start to the last push of the stretches before it.

    `left` and `latest` are (batch, groups, plays, lanes), the latter as `note_latest` counts; `gx` is
    (batch, time), `gr` (batch, plays), both added to. `gh` (batch, plays) is the gradient of the
    states after the record on entry and that of the states before it on return.
    """
    batch, groups, plays, lanes = left.shape
    samples = gx.shape[1]
    for row in range(batch):
        for i in range(plays):
            carried = gh[row, i]
            for group in range(groups - 1, -1, -1):
                for lane in range(lanes - 1, -1, -1):
                    push = latest[row, group, i, lane]
                    if push != 0 and push != np.inf:
                        t = (group * lanes + lane) * length + int(abs(push)) - 1
                        gx[row, min(t, samples - 1)] += carried
                        gr[row, i] += carried if push > 0 else -carried
                        carried = gx.dtype.type(0)
                    carried += left[row, group, i, lane]
            gh[row, i] = carried


@njit
def accumulate(factor: float, a: np.ndarray, count: int, out: np.ndarray) -> None:
    for q in range(count):
        out[q] += factor * a[q]


@njit_sum
def dot(a: np.ndarray, b: np.ndarray, count: int) -> float:
    total: float = a.dtype.type(0)
    for q in range(count):
        total += a[q] * b[q]
    return total


@njit_sum
def raise_powers(
    power: np.ndarray, a: np.ndarray, factor: float, next_factor: float, total: np.ndarray
) -> tuple[float, float]:
    """Add `factor` times `power` to `total`, raise `power` by one factor `a` and sum it; then do so again.

    It does two powers at a time, because with one the pass over memory would take longer than the arithmetic.
    """
    summed, next_summed = a.dtype.type(0), a.dtype.type(0)
    for q in range(len(a)):
        following = power[q] * a[q]
        total[q] = total[q] + factor * power[q] + next_factor * following
        power[q] = following * a[q]
        summed += following
        next_summed += power[q]
    return summed, next_summed
