"""The nominal hysteresis: rows of elementary states, linear in their weights."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from torchpi.diagnosis.outside import Outside, shifted
from torchpi.diagnosis.remanence import COLUMNS, excursions, fading
from torchpi.operators.hysteresis_rows import (
    DUHEM_POWERS,
    bend,
    bouc_wen_row,
    duhem_row,
    gain_inside,
    play_states,
    play_sum,
    smooth,
    straight_gain,
    sums_of_plain_plays,
    threshold_widening,
)
from torchpi.stage.effects.effect import DataRange
from torchpi.stage.hysteresis import IDENTITY

BLOCK = 256
"""Samples whose states are mixed at a time: they stay in the cache, however many plays there are."""
CHANGING = ("asymmetry_per_v", "incongruence_per_v", "weight_s_per_v", "threshold_s_per_v", "loop_per_e")
"""Numbers of the shape that change what a play does; the others only say how."""
DEGREE = 5
"""Of output functions."""
FIRM = 30.0
"""Times that a simulation's row is larger: a correction beside it costs more than its own gain."""


@dataclass(frozen=True, eq=False)
class HysteresisModel:
    """A hysteresis without its weights.

    The rows are h_i of the plays, their powers up to `degree` (output functions), then the states of the
    other families; all of them in volts.
    """

    thresholds_v: np.ndarray
    degree: int = 1
    scale_v: float = 1.0
    bouc_wen: bool = False
    duhem: bool = False
    shape: dict[str, float] = field(default_factory=lambda: dict(IDENTITY))
    """Parameters inside the hysteresis, the rest being 0; of Bouc–Wen and Duhem too."""
    start: float = 0.0
    """Of z before a recording."""
    reduction: np.ndarray | None = None
    """(kept rows, rows): combinations that the data can tell apart; None keeps all."""
    simulation: Outside | None = None
    """A simulation that is not torchpi's, the last of the rows: what else there is corrects it."""
    called: Callable[[np.ndarray], np.ndarray] | None = None
    """The same on one recording: (time,), µm, for a voltage, (time,), V."""
    late: int = 0
    """Samples by which all of it is late, or early: a simulation that does not change with time need not be
    called again for that."""

    @property
    def family(self) -> str:
        """As in `diagnosis.json`."""
        if self.bouc_wen:
            return "bouc_wen"
        if self.duhem:
            return "duhem"
        if self.degree > 1:
            return "preisach"
        return "prandtl_ishlinskii" if len(self.thresholds_v) else "simulation"

    @property
    def has_states(self) -> bool:
        """Whether it has states that are no plays."""
        return self.bouc_wen or self.duhem

    @property
    def size(self) -> int:
        """Numbers in it, before any reduction."""
        others = self.bouc_wen + len(DUHEM_POWERS) * self.duhem + (self.simulation is not None)
        return len(self.thresholds_v) * self.degree + others

    @cached_property
    def structure(self) -> tuple[object, ...]:
        """What tells two sets of rows apart, beside the shape."""
        mixed = None if self.reduction is None else self.reduction.tobytes()
        outside = self.simulation.token if self.simulation else ""
        return (self.thresholds_v.tobytes(), self.degree, self.bouc_wen, self.duhem, hash(mixed), outside)

    @property
    def remembers(self) -> int:
        """Columns of what a recording may remember from before it began: a line remembers nothing, and where
        a Bouc–Wen state starts is a number."""
        return COLUMNS * self.wipes_out + self.duhem

    def remembered(self, v: np.ndarray) -> np.ndarray:
        """(remembers, time) for a voltage, (time,), where it remembers anything."""
        columns = [excursions(v)] if self.wipes_out else []
        if self.duhem:
            columns.append(fading(v, self.shape["alpha_per_v"])[None])
        return np.concatenate(columns)

    @property
    def wipes_out(self) -> bool:
        """Whether it has what larger excursions wipe out: plays that are more than a line; a simulation."""
        return bool(self.simulation or self.thresholds_v.any())

    def with_shape(self, values: dict[str, float]) -> "HysteresisModel":
        return replace(self, shape={**self.shape, **values})

    @property
    def kept(self) -> int:
        """Rows that are left after reduction."""
        return self.size if self.reduction is None else len(self.reduction)

    def fill(self, v: np.ndarray, period_s: float, rows: np.ndarray) -> None:
        """Into `rows`, (kept, time), for a voltage (time,) from the de-energised state."""
        outside, v = self.of_simulation(v), shifted(v, self.late)
        inside = self.inside(v, period_s)
        others = np.array(self.other_rows(v, inside[-3], inside[-1]) + outside).reshape(-1, len(v))
        plays = len(self.thresholds_v) * self.degree
        if self.plain and self.reduction is not None:
            self.plain_sums(v, self.reduction[:, :plays], rows)
            if len(others):
                rows += self.reduction[:, plays:] @ others
            return
        h = np.zeros(len(self.thresholds_v))
        states = np.empty((BLOCK, self.degree, len(h)))
        for first in range(0, len(v), BLOCK):
            part = slice(first, min(first + BLOCK, len(v)))
            x = states[: part.stop - first]
            chord, up, down, widening, gain, straight, loop = (one[part] for one in inside)
            play_states(
                chord, up, down, self.thresholds_v, widening, gain, straight, loop, self.scale_v, h, x
            )
            of_plays = x.reshape(len(x), plays).T
            if self.reduction is None:
                rows[:plays, part], rows[plays:, part] = of_plays, others[:, part]
            else:
                rows[:, part] = (
                    self.reduction[:, :plays] @ of_plays + self.reduction[:, plays:] @ others[:, part]
                )

    def output(self, v: np.ndarray, period_s: float, weights: np.ndarray) -> np.ndarray:
        """(time,): weights @ rows, without the rows of the plays."""
        full = weights if self.reduction is None else self.reduction.T @ weights
        outside, v = self.of_simulation(v), shifted(v, self.late)
        plays = len(self.thresholds_v) * self.degree
        chord, up, down, widening, gain, straight, loop = self.inside(v, period_s)
        y = np.empty(len(v))
        if self.plain:
            self.plain_sums(v, full[None, :plays], y[None])
        else:
            y = play_sum(
                chord, up, down, self.thresholds_v, widening, gain, straight, loop, self.scale_v,
                full[:plays].reshape(self.degree, -1).copy(),
            )  # fmt: skip
        for weight, row in zip(full[plays:], self.other_rows(v, gain, loop) + outside, strict=True):
            y += weight * row
        return y

    def of_stage(self, weights: np.ndarray) -> np.ndarray:
        """Weights of the rows as a stage has them, (size,), whose Bouc–Wen state has no unit."""
        full = weights.copy() if self.reduction is None else self.reduction.T @ weights
        if self.bouc_wen:
            full[len(self.thresholds_v) * self.degree] *= self.scale_v
        return full

    @property
    def plain(self) -> bool:
        """Whether nothing inside the hysteresis changes its plays."""
        return not any(self.shape[name] for name in CHANGING)

    def plain_sums(self, v: np.ndarray, weights: np.ndarray, y: np.ndarray) -> None:
        """Into `y`, (sums, time): the plays with these weights, (sums, powers of plays)."""
        each = weights.reshape(len(weights), self.degree, -1).transpose(1, 2, 0)
        sums_of_plain_plays(v, self.thresholds_v, self.scale_v, np.ascontiguousarray(each), y)

    def inside(self, v: np.ndarray, period_s: float) -> tuple[np.ndarray, ...]:
        """The chord, envelopes up and down, widening of the thresholds, gains, widening of the loop."""
        s = self.shape
        rate = np.diff(v, prepend=0.0) / period_s
        if s["rate_filter_s"] > 0.0:
            rate = smooth(rate, np.exp(-period_s / s["rate_filter_s"]))
        bent: Any = bend(v, s["asymmetry_per_v"])  # type: ignore[arg-type]
        widening: Any = threshold_widening(rate, s["threshold_s_per_v"])  # type: ignore[arg-type]
        gain: Any = gain_inside(v, rate, s["incongruence_per_v"], s["weight_s_per_v"])  # type: ignore[arg-type]
        straight: Any = straight_gain(gain, s["straight_share"])
        loop = s["loop_per_e"] * np.log1p(np.abs(rate) / s["reference_rate_v_s"])
        return s["chord_share"] * v, v + bent, v - bent, widening, gain, straight, loop

    def other_rows(self, v: np.ndarray, gain: np.ndarray, loop: np.ndarray) -> list[np.ndarray]:
        """States of the other families."""
        rows = []
        if self.bouc_wen:
            numbers = (self.shape["sigma_v"], self.shape["beta"], self.shape["exponent"])
            z = bouc_wen_row(v, *numbers, self.start) * gain
            # In the unit of the plays, whose weights have one prior.
            rows.append(self.scale_v * (z + z * loop))
        if self.duhem:
            alpha = self.shape["alpha_per_v"]
            rows += [duhem_row(v, alpha, k) / self.scale_v ** (k - 1) for k in DUHEM_POWERS]
        return rows

    def of_simulation(self, v: np.ndarray) -> list[np.ndarray]:
        """What a simulation makes of a voltage, (time,)."""
        return [FIRM * shifted(self.called(v), self.late)] if self.called else []


def thresholds(seen: DataRange, fine: int, even: int) -> np.ndarray:
    """0, then `fine` spread evenly in the logarithm and `even` evenly, up to where a play still moves."""
    reach = reach_v(seen)
    r = [np.zeros(1), np.geomspace(0.003 * reach, 0.97 * reach, fine)]
    return np.unique(np.concatenate([*r, np.linspace(0, 0.97 * reach, even + 1)[1:]]))


def reach_v(seen: DataRange) -> float:
    """The largest threshold that a play passes from the de-energised state."""
    return max(abs(seen.low_v), abs(seen.high_v), seen.span_v / 2)


def plain(seen: DataRange) -> HysteresisModel:
    """Ten plays: the plain stage of the paper's kind."""
    return HysteresisModel(thresholds(seen, 0, 9), 1, reach_v(seen))


def many_plays(seen: DataRange) -> HysteresisModel:
    """A hundred plays: any Prandtl–Ishlinskii operator, down to the noise."""
    return HysteresisModel(thresholds(seen, 20, 80), 1, reach_v(seen))


def preisach(seen: DataRange, fine: int = 10, even: int = 20, degree: int = DEGREE) -> HysteresisModel:
    """Plays through output functions: a Preisach operator in play form."""
    return HysteresisModel(thresholds(seen, fine, even), degree, reach_v(seen))


def bouc_wen(seen: DataRange, sigma: float) -> HysteresisModel:
    """A Bouc–Wen state on a line."""
    shape = {**IDENTITY, "sigma_v": sigma * reach_v(seen), "beta": 0.6, "exponent": 1.2}
    return HysteresisModel(np.zeros(1), 1, reach_v(seen), bouc_wen=True, shape=shape)


def duhem(seen: DataRange) -> HysteresisModel:
    """A bank of Duhem states on a curve: also what does not close its loops."""
    shape = {**IDENTITY, "alpha_per_v": 1.0 / reach_v(seen)}
    return HysteresisModel(np.zeros(1), DUHEM_POWERS[-1], reach_v(seen), duhem=True, shape=shape)
