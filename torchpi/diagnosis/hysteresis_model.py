"""The nominal hysteresis: rows of elementary states, in whose weights it is linear."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from hashlib import sha256
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from torchpi.diagnosis.long_recordings import shifted
from torchpi.diagnosis.outside import Outside
from torchpi.diagnosis.remanence import COLUMNS, excursions, fading
from torchpi.diagnosis.smooth_density import SMOOTH, roughness, terms
from torchpi.operators.hysteresis_rows import (
    DUHEM_POWERS,
    bend,
    bouc_wen_row,
    duhem_rows,
    gain_inside,
    kept_after,
    offsets_of,
    play_states,
    play_sum,
    smooth,
    straight_gain,
    sums_of_plain_plays,
    sums_of_plays,
    threshold_widening,
)
from torchpi.stage.effects.effect import DataRange
from torchpi.stage.hysteresis import IDENTITY, Hysteresis

BLOCK = 256
"""Samples whose states are summed at a time, so that they fit into the cache for any number of plays."""
CHANGING = (
    "asymmetry_per_v",
    "incongruence_per_v",
    "weight_s_per_v",
    "threshold_s_per_v",
    "loop_per_e",
    "relaxation_s",
)
"""Shape parameters that change what a play does; the others only say how."""
PIECES = 48
"""Number of pieces of each output function of a Preisach operator."""
CURVE = 200
"""Number of pieces of a curve."""
FIRM = 30.0
"""Factor that enlarges a simulation's row, so that a correction beside it costs more than its own gain."""


@dataclass(frozen=True, eq=False)
class HysteresisModel:
    """A hysteresis without its weights.

    The rows are first those of the plays, one for each piece of their output functions, then the states of
    the other families, all in volts.
    """

    thresholds_v: np.ndarray
    pieces: int = 1
    range_v: tuple[float, float] = (-1.0, 1.0)
    scale_v: float = 1.0
    bouc_wen: bool = False
    duhem: bool = False
    shape: dict[str, float] = field(default_factory=lambda: dict(IDENTITY))
    """Shape parameters, including those of Bouc–Wen and Duhem; those not set are as in `IDENTITY`."""
    start: float = 0.0
    """Initial value of z before a recording."""
    reduction: np.ndarray | None = None
    """(kept rows, rows): combinations that the data can distinguish; None keeps all rows. Output functions
    with several pieces always have a reduction."""
    centre: np.ndarray | None = None
    """(size,): the weights at which the prior of all rows is centred, those of a given stage; None for 0."""
    simulation: Outside | None = None
    """A simulation from outside torchpi, the last of the rows, which the other rows correct."""
    called: Callable[[np.ndarray], np.ndarray] | None = None
    """That simulation on one recording: maps a voltage, (time,), V, to a displacement, (time,), µm."""
    late: int = 0
    """Number of samples by which all rows are shifted."""

    @property
    def family(self) -> str:
        """The name of the family as in `diagnosis.json`."""
        if self.bouc_wen:
            return "bouc_wen"
        if self.duhem:
            return "duhem"
        if self.pieces > 1:
            return "preisach"
        return "prandtl_ishlinskii" if len(self.thresholds_v) else "simulation"

    @property
    def has_states(self) -> bool:
        """Whether it has states other than plays."""
        return self.bouc_wen or self.duhem

    @property
    def of_plays(self) -> int:
        """Number of weights that are slopes of output functions."""
        return len(self.thresholds_v) * self.pieces

    @property
    def size(self) -> int:
        """Number of weights, before any reduction."""
        others = self.bouc_wen + len(DUHEM_POWERS) * self.duhem + (self.simulation is not None)
        return self.of_plays + others

    @cached_property
    def structure(self) -> tuple[object, ...]:
        """A key that distinguishes two sets of rows, apart from the shape, in any process."""
        mixed = b"" if self.reduction is None else sha256(self.reduction.tobytes()).digest()
        outside = self.simulation.token if self.simulation else ""
        return (self.thresholds_v.tobytes(), self.pieces, self.bouc_wen, self.duhem, mixed, outside)

    @property
    def remembers(self) -> int:
        """Number of columns for the unknown history before a recording. A straight line has no memory; the
        initial state of Bouc–Wen is a fitted parameter instead."""
        return COLUMNS * self.wipes_out + self.duhem

    def remembered(self, v: np.ndarray) -> np.ndarray:
        """Return the history columns, (remembers, time), for a voltage, (time,), if there are any."""
        columns = [excursions(v)] if self.wipes_out else []
        if self.duhem:
            columns.append(fading(v, self.shape["alpha_per_v"])[None])
        return np.concatenate(columns)

    @property
    def wipes_out(self) -> bool:
        """Whether larger excursions wipe out its memory: it has plays beyond a line, or a simulation."""
        return bool(self.simulation or self.thresholds_v.any())

    def with_shape(self, values: dict[str, float]) -> "HysteresisModel":
        changed = replace(self, shape={**self.shape, **values})
        vars(changed)["structure"] = self.structure  # which takes time where there are many rows
        return changed

    @property
    def kept(self) -> int:
        """Number of rows left after reduction."""
        return self.size if self.reduction is None else len(self.reduction)

    @property
    def unreduced(self) -> "HysteresisModel":
        """The same hysteresis on all rows of plays, or on the slowly varying terms of a density."""
        if self.pieces == 1:
            return replace(self, reduction=None)
        of_plays = terms(self.pieces, len(self.thresholds_v))
        return replace(self, reduction=block_diag(of_plays, np.eye(self.size - self.of_plays)))

    def inverse_variances(self, of_one: float, gain_um_per_v: float) -> np.ndarray:
        """Return the inverse prior variances of unreduced rows' weights, (kept,); `of_one` is that of one.

        The prior lets the line of a curve be as large as the gain. A tighter prior would undo, beyond the
        recorded range, what bends the curve within it.
        """
        found = np.full(self.kept, of_one)
        if self.pieces > 1:
            if self.simulation is None:
                found[0] = 1.0 / gain_um_per_v**2
            bent = slice(len(self.thresholds_v), self.kept - self.size + self.of_plays)
            found[bent] = SMOOTH / gain_um_per_v**2
        return found

    def inverse_covariance(self, of_one: float, gain_um_per_v: float) -> np.ndarray:
        """Return the inverse prior covariance of the rows' weights, (kept, kept); `of_one` is that of one.
        Unless a simulation carries the gain of the stage, the line of a curve does, and has no prior."""
        rows = np.eye(self.size) if self.reduction is None else self.reduction
        if self.pieces == 1:
            return of_one * rows @ rows.T
        of_plays, others = np.split(rows, [self.of_plays], axis=1)
        slopes = of_plays.reshape(len(rows), self.pieces, -1)
        rough, lines = roughness(slopes), np.concatenate([slopes.mean(1), others], 1)
        if self.simulation is None:
            lines[:, 0] = 0.0
        both: np.ndarray = of_one * (lines @ lines.T) + SMOOTH / gain_um_per_v**2 * (rough @ rough.T)
        return both

    def fill(self, v: np.ndarray, period_s: float, rows: np.ndarray) -> None:
        """Write the rows for a voltage (time,) from the de-energised state into `rows`, (kept, time)."""
        outside, v = self.of_simulation(v), shifted(v, self.late)
        inside = self.inside(v, period_s)
        others = self.other_rows(v, inside[-3], inside[-1]) + outside
        self.fill_plays(v, inside, kept_after(period_s, self.shape["relaxation_s"]), rows)
        if self.reduction is None:
            rows[self.of_plays :] = np.reshape(others, (-1, len(v)))
        elif others:
            rows += self.reduction[:, self.of_plays :] @ np.array(others)

    def fill_plays(
        self, v: np.ndarray, inside: tuple[np.ndarray, ...], kept: float, rows: np.ndarray
    ) -> None:
        """Write the rows of the plays alone, as `fill` does."""
        r, h, plays = self.thresholds_v, np.zeros(len(self.thresholds_v)), self.of_plays
        mixed = None if self.reduction is None else self.reduction[:, :plays]
        if mixed is not None and self.plain:
            self.plain_sums(v, mixed, rows)
            return
        functions = () if mixed is None or self.pieces == 1 else self.output_functions(mixed)
        for first in range(0, len(v), BLOCK):
            part = slice(first, min(first + BLOCK, len(v)))
            now, samples = [one[part] for one in inside], len(v[part])
            if functions:
                sums: tuple[Any, ...] = (*now, r, kept, *functions, h, np.empty((samples, len(rows))))
                sums_of_plays(*sums)
                rows[:, part] = sums[-1].T
                continue
            states: tuple[Any, ...] = (*now, r, kept, h, np.empty((samples, plays)))
            play_states(*states)
            if mixed is None:
                rows[:plays, part] = states[-1].T
            else:
                rows[:, part] = mixed @ states[-1].T

    def output(self, v: np.ndarray, period_s: float, weights: np.ndarray) -> np.ndarray:
        """Return weights @ rows, (time,), without storing the rows of the plays."""
        full = weights if self.reduction is None else self.reduction.T @ weights
        outside, v = self.of_simulation(v), shifted(v, self.late)
        plays, inside = self.of_plays, self.inside(v, period_s)
        y = np.empty(len(v))
        if self.plain:
            self.plain_sums(v, full[None, :plays], y[None])
        else:
            low_v, piece_v, slopes, offsets = self.output_functions(full[None, :plays])
            functions: tuple[Any, ...] = (low_v, piece_v, slopes[..., 0].copy(), offsets[..., 0].copy())
            kept = kept_after(period_s, self.shape["relaxation_s"])
            arguments: tuple[Any, ...] = (*inside, self.thresholds_v, kept, *functions)
            y = play_sum(*arguments)
        others = self.other_rows(v, inside[-3], inside[-1]) + outside
        for weight, row in zip(full[plays:], others, strict=True):
            y += weight * row
        return y

    def of_stage(self, weights: np.ndarray) -> np.ndarray:
        """Return the weights as a stage has them, (size,): there the Bouc–Wen state is dimensionless."""
        full = weights.copy() if self.reduction is None else self.reduction.T @ weights
        if self.bouc_wen:
            full[self.of_plays] *= self.scale_v
        return full

    @property
    def plain(self) -> bool:
        """Whether nothing inside the hysteresis changes its plays."""
        return not any(self.shape[name] for name in CHANGING)

    def plain_sums(self, v: np.ndarray, weights: np.ndarray, y: np.ndarray) -> None:
        """Write the sums of the plays with weights (sums, pieces × plays) into `y`, (sums, time)."""
        sums_of_plain_plays(v, self.thresholds_v, *self.output_functions(weights), y)

    def output_functions(self, weights: np.ndarray) -> tuple[float, float, np.ndarray, np.ndarray]:
        """Return the start of the first piece, the length of each, slopes and offsets, (pieces, plays, sums).

        The weights are (sums, pieces × plays).
        """
        low_v, high_v = self.range_v
        piece_v = (high_v - low_v) / self.pieces
        slopes = weights.reshape(len(weights), self.pieces, -1).transpose(1, 2, 0)
        return low_v, piece_v, np.ascontiguousarray(slopes), np.array(offsets_of(slopes, low_v, piece_v))

    def inside(self, v: np.ndarray, period_s: float) -> tuple[np.ndarray, ...]:
        """Chord, envelopes up and down, threshold widening, gain, straight gain, loop widening."""
        s = self.shape
        rate = np.diff(v, prepend=0.0) / period_s
        if s["rate_filter_s"] > 0.0:
            rate = smooth(rate, kept_after(period_s, s["rate_filter_s"]))
        bent: Any = bend(v, s["asymmetry_per_v"])  # type: ignore[arg-type]
        widening: Any = threshold_widening(rate, s["threshold_s_per_v"])  # type: ignore[arg-type]
        gain: Any = gain_inside(v, rate, s["incongruence_per_v"], s["weight_s_per_v"])  # type: ignore[arg-type]
        straight: Any = straight_gain(gain, s["straight_share"])
        loop = s["loop_per_e"] * np.log1p(np.abs(rate) / s["reference_rate_v_s"])
        return s["chord_share"] * v, v + bent, v - bent, widening, gain, straight, loop

    def other_rows(self, v: np.ndarray, gain: np.ndarray, loop: np.ndarray) -> list[np.ndarray]:
        """Return the rows of Bouc–Wen and Duhem states."""
        rows = []
        if self.bouc_wen:
            numbers = (self.shape["sigma_v"], self.shape["beta"], self.shape["exponent"])
            z = bouc_wen_row(v, *numbers, self.start) * gain
            # In the unit of the plays, because one prior serves all weights.
            rows.append(self.scale_v * (z + z * loop))
        if self.duhem:
            alpha = self.shape["alpha_per_v"]
            rows += [
                row / self.scale_v ** (k - 1)
                for k, row in zip(DUHEM_POWERS, duhem_rows(v, alpha), strict=True)
            ]
        return rows

    def of_simulation(self, v: np.ndarray) -> list[np.ndarray]:
        """Return the row of a simulation, if there is one, for a voltage, (time,)."""
        return [FIRM * shifted(self.called(v), self.late)] if self.called else []


def thresholds(seen: DataRange, fine: int, even: int) -> np.ndarray:
    """Return 0, `fine` log-spaced and `even` evenly spaced thresholds, up to where a play still moves."""
    reach = reach_v(seen)
    r = [np.zeros(1), np.geomspace(0.003 * reach, 0.97 * reach, fine)]
    return np.unique(np.concatenate([*r, np.linspace(0, 0.97 * reach, even + 1)[1:]]))


def reach_v(seen: DataRange) -> float:
    """The largest threshold at which a play still moves from the de-energised state."""
    return max(abs(seen.low_v), abs(seen.high_v), seen.span_v / 2)


def plays_of(seen: DataRange, r: np.ndarray, pieces: int = 1, **states: Any) -> HysteresisModel:
    """Plays over the voltage range of the recordings, extended to the de-energised state."""
    return HysteresisModel(r, pieces, (min(seen.low_v, 0.0), max(seen.high_v, 0.0)), reach_v(seen), **states)


def plain(seen: DataRange, given: Hysteresis | None = None) -> HysteresisModel:
    """Ten plays: a plain stage of the paper's kind; and the plays of a given one."""
    return with_given_plays(seen, thresholds(seen, 0, 9), given)


def many_plays(seen: DataRange, given: Hysteresis | None = None) -> HysteresisModel:
    """A hundred plays, which match any Prandtl–Ishlinskii operator closely; and the plays of a given one."""
    return with_given_plays(seen, thresholds(seen, 20, 80), given)


def with_given_plays(seen: DataRange, r: np.ndarray, given: Hysteresis | None) -> HysteresisModel:
    """Plays with these thresholds, and with those of a given hysteresis that is a weighted sum of plays. That
    one then remains as it is wherever the recordings say nothing else."""
    if given is None or not given.is_weighted_sum:
        return plays_of(seen, r)
    theirs = given.thresholds_v.numpy()
    moving = theirs < reach_v(seen)
    r = np.union1d(r, theirs[moving])
    centre = np.zeros(len(r))
    np.add.at(centre, np.searchsorted(r, theirs[moving]), given.weights.detach().numpy()[:-1][moving])
    return replace(plays_of(seen, r), centre=centre)


def preisach(seen: DataRange, pieces: int = PIECES, given: Hysteresis | None = None) -> HysteresisModel:
    """The same plays through output functions: a Preisach operator in play form."""
    return replace(many_plays(seen, given), pieces=pieces, centre=None).unreduced


def as_given(seen: DataRange, given: Hysteresis) -> HysteresisModel:
    """The states of a given hysteresis, as far as its plays move."""
    theirs = given.thresholds_v.numpy()
    states = {"bouc_wen": given.bouc_wen, "duhem": given.duhem, "shape": IDENTITY | given.fixed}
    nominal = plays_of(seen, theirs[theirs < reach_v(seen)], given.pieces, **states)
    return replace(nominal, range_v=(given.low_v, given.high_v)).unreduced


def bouc_wen(seen: DataRange, sigma: float) -> HysteresisModel:
    """A Bouc–Wen state added to a straight line."""
    shape = {**IDENTITY, "sigma_v": sigma * reach_v(seen), "beta": 0.6, "exponent": 1.2}
    return plays_of(seen, np.zeros(1), bouc_wen=True, shape=shape)


def duhem(seen: DataRange) -> HysteresisModel:
    """A bank of Duhem states added to a curve, which can also describe loops that do not close."""
    shape = {**IDENTITY, "alpha_per_v": 1.0 / reach_v(seen)}
    return plays_of(seen, np.zeros(1), CURVE, duhem=True, shape=shape).unreduced
