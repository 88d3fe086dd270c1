"""Play states of a direct inverse over a record, block by block, with their exact derivative.

A play rests on the last sample p that pushed it, h_i(t) = S(x(p)) ∓ r_i, so its derivative is that of S(x) at
the sample p, and ∓1 with respect to r_i. Only one block is stored at a time, so a record of any length is
fitted in the memory of one block.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from torchpi.identification.pair import InversePair
from torchpi.operators.compiled import njit
from torchpi.operators.linear import observe
from torchpi.operators.play_equation import play
from torchpi.operators.polynomial import horner
from torchpi.operators.relaxations import relax

SAMPLES = 2000  # samples of a block, which fits in a core's cache


class Nonlinear(NamedTuple):
    """α: the parameters that the voltage is not linear in, in physical units."""

    lead: np.ndarray  # τ_1 in s, τ_2 in s²: (order,)
    gains: np.ndarray  # g of the relaxations: (relaxations,)
    c: np.ndarray  # c_1 first: (degree,)
    r: np.ndarray  # (plays,)
    slope: np.ndarray  # of the neural rate head: (hidden,)
    shift: np.ndarray  # (hidden,)


class Record(NamedTuple):
    """One record, and those of its samples that are rows of the least-squares problem."""

    yd: np.ndarray  # (time,), µm
    yd_dot: np.ndarray
    yd_ddot: np.ndarray
    u: np.ndarray  # V
    counted: np.ndarray  # ascending indices: (rows,)
    weight: float = 1.0  # weight of its squared errors

    @classmethod
    def of(cls, pair: InversePair) -> "Record":
        """Take the samples up to the last that counts."""
        counted = np.arange(pair.u.shape[1])[pair.counted]
        yd, yd_dot, yd_ddot, u = (
            np.ascontiguousarray(part[0, : counted[-1] + 1].numpy(), dtype=np.float64)
            for part in (*pair.motion, pair.u)
        )
        return cls(yd, yd_dot, yd_ddot, u, counted, pair.weight)

    def with_rows(self, rows: np.ndarray) -> "Record":
        """Take these samples as rows, in place of those that count, and drop all samples after them."""
        yd, yd_dot, yd_ddot, u = (signal[: rows[-1] + 1] for signal in self[:4])
        return Record(yd, yd_dot, yd_ddot, u, rows, self.weight)

    def fewer_rows(self, step: int) -> "Record":
        """Keep every `step`-th row."""
        return self._replace(counted=self.counted[::step])

    def fewer_samples(self, step: int, lead: np.ndarray) -> "Record":
        """Keep every `step`-th row and drop the samples between them, except the turning points.

        If the input does not creep, the states of the plays are the same: they depend only on turning points.
        """
        x = self.yd.copy()
        for tau, derivative in zip(lead, self[1:3], strict=False):
            x += tau * derivative
        moves = np.diff(x)
        turns = 1 + np.flatnonzero(moves[1:] * moves[:-1] < 0)
        rows = self.counted[::step]
        kept = np.union1d(np.append(turns, [0, len(x) - 1]), rows)
        yd, yd_dot, yd_ddot, u = (signal[kept] for signal in self[:4])
        return Record(yd, yd_dot, yd_ddot, u, np.searchsorted(kept, rows), self.weight)

    def stretches(self) -> list["Stretch"]:
        """Cut the record into parts that fit in a core's cache."""
        edges = range(0, len(self.yd) + SAMPLES, SAMPLES)
        rows = np.searchsorted(self.counted, edges)
        cut = []
        for begin, first, last in zip(edges, rows[:-1], rows[1:], strict=False):
            counted = self.counted[first:last]
            yd, yd_dot, yd_ddot = (signal[begin : begin + SAMPLES] for signal in self[:3])
            cut.append(Stretch(yd, yd_dot, yd_ddot, counted - begin, self.yd_dot[counted], self.u[counted]))
        return cut


class Stretch(NamedTuple):
    """Consecutive samples of a record, with the rate and the voltage at the rows among them."""

    yd: np.ndarray  # (samples,)
    yd_dot: np.ndarray
    yd_ddot: np.ndarray
    rows: np.ndarray  # which samples: (rows,)
    rate: np.ndarray  # ẏ at the rows
    u: np.ndarray  # voltage at the rows


class Block(NamedTuple):
    """States of the plays, and their derivatives, at the rows of one stretch."""

    h: np.ndarray  # (rows, plays)
    pushed: np.ndarray  # row of `ds` that each state rests on: (rows, plays)
    edge: np.ndarray  # dh_i/dr_i, -1 or 1, or 0 before the first push: (rows, plays)
    ds: np.ndarray  # dS(x)/d(τ, g, c): (plays + samples, order + relaxations + degree)


def blocks(
    record: Sequence[Stretch], alpha: Nonlinear, decay: np.ndarray, derivative: bool
) -> Iterator[Block]:
    """Run through the record from the de-energised state. Each block is overwritten by the next.

    Without `derivative`, `pushed`, `edge` and `ds` are empty.
    """
    plays, order, relaxations = len(alpha.r), len(alpha.lead), len(alpha.gains)
    samples = len(record[0].yd)
    # A play that this block has not pushed rests on an earlier sample; `ds` begins with their derivatives.
    width = order + relaxations + len(alpha.c) if derivative else 0
    ds = np.empty((plays + samples if derivative else 0, width))
    h = np.empty((samples, plays))
    pushed = np.empty((samples if derivative else 0, plays), dtype=np.int64)
    edge = np.empty((samples if derivative else 0, plays))
    relaxed, states = np.zeros((1 + order, relaxations)), np.zeros(plays)
    signs, resting = np.zeros(plays), np.zeros((plays, width))
    rests_on = np.empty(plays, dtype=np.int64)
    for part in record:
        _run(
            part.yd, part.yd_dot, part.yd_ddot, part.rows,
            alpha.lead, alpha.gains, decay, 1.0 - decay, alpha.c, alpha.r,
            relaxed, states, signs, resting, rests_on, h, pushed, edge, ds,
        )  # fmt: skip
        count = len(part.rows)
        yield Block(h[:count], pushed[:count], edge[:count], ds)


_play, _horner, _relax, _observe = (njit(equation) for equation in (play, horner, relax, observe))


@njit
def _run(
    yd: np.ndarray, yd_dot: np.ndarray, yd_ddot: np.ndarray, rows: np.ndarray,
    lead: np.ndarray, gains: np.ndarray, decay: np.ndarray, take_in: np.ndarray, c: np.ndarray, r: np.ndarray,
    relaxed: np.ndarray,  # ξ driven by x_0, and by each derivative in the lead: (1 + order, relaxations)
    # State of the plays after the last sample: (plays,), (plays,), (plays, numbers that act through S).
    states: np.ndarray, signs: np.ndarray, resting: np.ndarray,
    rests_on: np.ndarray,  # row of `ds`: (plays,)
    h: np.ndarray, pushed: np.ndarray, edge: np.ndarray, ds: np.ndarray,
) -> None:  # fmt: skip
    order, relaxations, degree, plays = len(lead), len(gains), len(c), len(r)
    derivative = len(ds) > 0
    # Loops replace operations on whole arrays, which take Numba seconds to compile.
    if derivative:
        for i in range(plays):
            rests_on[i] = i
            for k in range(ds.shape[1]):
                ds[i, k] = resting[i, k]
    row = 0
    for t in range(len(yd)):
        x0 = yd[t]
        if order > 0:
            x0 = x0 + lead[0] * yd_dot[t]
        if order > 1:
            x0 = x0 + lead[1] * yd_ddot[t]
        x = x0
        if relaxations > 0:
            x = _observe(gains, 1.0, relaxed[0], x0)
        s = 0.0
        for k in range(degree - 1, -1, -1):
            s = _horner(s, c[k], x)

        at = plays + t
        if derivative:
            steepness = 0.0
            for k in range(degree, 0, -1):
                steepness = steepness * x + k * c[k - 1]
            for k in range(order):
                dx0 = yd_dot[t] if k == 0 else yd_ddot[t]
                dx = dx0
                if relaxations > 0:
                    dx = _observe(gains, 1.0, relaxed[1 + k], dx0)
                    _relax(decay, take_in, relaxed[1 + k], dx0)
                ds[at, k] = steepness * dx
            for j in range(relaxations):
                ds[at, order + j] = steepness * relaxed[0, j]
            power = x
            for k in range(degree):
                ds[at, order + relaxations + k] = power
                power *= x
        if relaxations > 0:
            _relax(decay, take_in, relaxed[0], x0)

        if derivative:
            for i in range(plays):
                if states[i] <= s - r[i]:
                    rests_on[i], signs[i] = at, -1.0
                elif states[i] >= s + r[i]:
                    rests_on[i], signs[i] = at, 1.0
                states[i] = _play(s, r[i], states[i])
        else:
            for i in range(plays):
                states[i] = _play(s, r[i], states[i])

        if row < len(rows) and t == rows[row]:
            for i in range(plays):
                h[row, i] = states[i]
                if derivative:
                    pushed[row, i], edge[row, i] = rests_on[i], signs[i]
            row += 1
    if derivative:
        for i in range(plays):
            for k in range(ds.shape[1]):
                resting[i, k] = ds[rests_on[i], k]


@njit
def through_plays(
    weights: np.ndarray,  # (rows, plays)
    pushed: np.ndarray,
    ds: np.ndarray,
) -> np.ndarray:  # (rows, numbers that act through S)
    """Return Σ_i weights_i dh_i/dα at each row."""
    out = np.zeros((len(weights), ds.shape[1]))
    for t in range(len(weights)):
        # Moving plays rest on the same sample, so their weights are added first.
        moving = pushed[t, 0]
        together = 0.0
        for i in range(weights.shape[1]):
            weight, at = weights[t, i], pushed[t, i]
            if at == moving:
                together += weight
            else:
                for k in range(ds.shape[1]):
                    out[t, k] += weight * ds[at, k]
        for k in range(ds.shape[1]):
            out[t, k] += together * ds[moving, k]
    return out


@njit
def over_rows(
    weights: np.ndarray,  # (rows, plays)
    pushed: np.ndarray,
    ds: np.ndarray,
) -> np.ndarray:  # (plays, numbers that act through S)
    """Return Σ_t weights_i(t) dh_i(t)/dα of each play."""
    out = np.zeros((weights.shape[1], ds.shape[1]))
    for t in range(len(weights)):
        for i in range(weights.shape[1]):
            weight, at = weights[t, i], pushed[t, i]
            for k in range(ds.shape[1]):
                out[i, k] += weight * ds[at, k]
    return out
