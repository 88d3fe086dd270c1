"""The nominal hysteresis: rows of elementary states, linear in their weights."""

from dataclasses import dataclass, field, replace

import numpy as np

from torchpi.operators.hysteresis_rows import bouc_wen_row, duhem_row, play_rows, play_sum, smooth
from torchpi.stage.effects.effect import Seen

INSIDE = {
    "asymmetry_per_v": 0.0,
    "incongruence_per_v": 0.0,
    "weight_s_per_v": 0.0,
    "threshold_s_per_v": 0.0,
    "loop_per_e": 0.0,
    "reference_rate_v_s": 1.0,
    "rate_filter_s": 0.0,
}


@dataclass(frozen=True, eq=False)
class Nominal:
    """A hysteresis without its weights.

    The rows are h_i of the plays, their powers up to `degree` (output functions), then the states of the
    other families; a constant is the last row.
    """

    thresholds_v: np.ndarray
    degree: int = 1
    scale_v: float = 1.0
    bouc_wen: bool = False
    duhem: bool = False
    shape: dict[str, float] = field(default_factory=lambda: dict(INSIDE))
    """Parameters inside the hysteresis, the rest being 0; of Bouc–Wen and Duhem too."""
    mixing: np.ndarray | None = None
    """(kept rows, rows): combinations that the data can tell apart; None keeps all."""

    @property
    def family(self) -> str:
        """As in `diagnosis.json`."""
        if self.bouc_wen:
            return "bouc_wen"
        if self.duhem:
            return "duhem"
        return "preisach" if self.degree > 1 else "prandtl_ishlinskii"

    @property
    def structure(self) -> tuple[object, ...]:
        """What tells two sets of rows apart, beside the shape."""
        mixed = None if self.mixing is None else self.mixing.tobytes()
        return (self.thresholds_v.tobytes(), self.degree, self.bouc_wen, self.duhem, hash(mixed))

    def with_shape(self, values: dict[str, float]) -> "Nominal":
        return replace(self, shape={**self.shape, **values})

    def rows(self, v: np.ndarray, period_s: float) -> np.ndarray:
        """(rows, time) for a voltage (time,) from the de-energised state."""
        rows = self.all_rows(v, period_s)
        return rows if self.mixing is None else self.mixing @ rows

    def all_rows(self, v: np.ndarray, period_s: float) -> np.ndarray:
        """Every row: the plays, their powers, the other families, the constant."""
        others = self.other_rows(v)
        plays = len(self.thresholds_v) * self.degree
        rows = np.empty((plays + len(others), len(v)))
        up, down, widening, gain, loop = self.inside(v, period_s)
        play_rows(
            v, up, down, self.thresholds_v, widening, gain, loop, self.scale_v,
            rows[:plays].reshape(self.degree, -1, len(v)),
        )  # fmt: skip
        rows[plays:] = others
        return rows

    def output(self, v: np.ndarray, period_s: float, weights: np.ndarray) -> np.ndarray:
        """(time,): weights @ rows, without the rows of the plays."""
        full = weights if self.mixing is None else self.mixing.T @ weights
        plays = len(self.thresholds_v) * self.degree
        up, down, widening, gain, loop = self.inside(v, period_s)
        y: np.ndarray = play_sum(
            v, up, down, self.thresholds_v, widening, gain, loop, self.scale_v,
            full[:plays].reshape(self.degree, -1).copy(),
        )  # fmt: skip
        for weight, row in zip(full[plays:], self.other_rows(v), strict=True):
            y += weight * row
        return y

    def inside(self, v: np.ndarray, period_s: float) -> tuple[np.ndarray, ...]:
        """Envelopes up and down, widening of the thresholds, gain of the states, widening of the loop."""
        s, one = self.shape, np.ones_like(v)
        rate = np.diff(v, prepend=0.0) / period_s
        if s["rate_filter_s"] > 0.0:
            rate = smooth(rate, np.exp(-period_s / s["rate_filter_s"]))
        bend = s["asymmetry_per_v"] * v * v
        gain = (1.0 + s["incongruence_per_v"] * v) * (1.0 + s["weight_s_per_v"] * rate)
        loop = s["loop_per_e"] * np.log1p(np.abs(rate) / s["reference_rate_v_s"])
        return v + bend, v - bend, one + s["threshold_s_per_v"] * np.abs(rate), gain, loop

    def other_rows(self, v: np.ndarray) -> list[np.ndarray]:
        """States of the other families, and the constant."""
        rows = []
        if self.bouc_wen:
            rows.append(bouc_wen_row(v, self.shape["sigma_v"], self.shape["beta"], self.shape["exponent"]))
        if self.duhem:
            rows += [duhem_row(v, self.shape["alpha_per_v"], k) / self.scale_v ** (k - 1) for k in (1, 2, 3)]
        return [*rows, np.ones(len(v))]


def thresholds(seen: Seen, fine: int, even: int) -> np.ndarray:
    """0, then `fine` spread evenly in the logarithm and `even` evenly, up to where a play still moves."""
    reach = reach_v(seen)
    r = [np.zeros(1), np.geomspace(0.003 * reach, 0.97 * reach, fine)]
    return np.unique(np.concatenate([*r, np.linspace(0, 0.97 * reach, even + 1)[1:]]))


def reach_v(seen: Seen) -> float:
    """The largest threshold that a play passes from the de-energised state."""
    return max(abs(seen.low_v), abs(seen.high_v), seen.span_v / 2)


def plain(seen: Seen) -> Nominal:
    """Ten plays: the plain stage of the paper's kind."""
    return Nominal(thresholds(seen, 0, 9), 1, reach_v(seen))


def many_plays(seen: Seen) -> Nominal:
    """A hundred plays: any Prandtl–Ishlinskii operator, down to the noise."""
    return Nominal(thresholds(seen, 20, 80), 1, reach_v(seen))


def preisach(seen: Seen, degree: int) -> Nominal:
    """Thirty plays through output functions: a Preisach operator in play form."""
    return Nominal(thresholds(seen, 10, 20), degree, reach_v(seen))


def bouc_wen(seen: Seen, sigma: float) -> Nominal:
    """A Bouc–Wen state beside the straight line."""
    shape = {**INSIDE, "sigma_v": sigma * reach_v(seen), "beta": 0.6, "exponent": 1.2}
    return Nominal(np.zeros(1), 1, reach_v(seen), bouc_wen=True, shape=shape)


def duhem(seen: Seen, alpha: float) -> Nominal:
    """Duhem states beside the straight line."""
    shape = {**INSIDE, "alpha_per_v": alpha / reach_v(seen)}
    return Nominal(np.zeros(1), 1, reach_v(seen), duhem=True, shape=shape)
