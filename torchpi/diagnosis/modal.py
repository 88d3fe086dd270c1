"""Modes driven by every recorded input: a stage that rings as a whole, whichever axis is moved.

No single resonance or coupling explains such a stage, and each alone explains little. The poles, which all
inputs share, are therefore found together: modes are added one by one where the residual stands out, all
poles are refined after each, and all residues are solved for at every step (variable projection: Golub and
Pereyra 1973; common poles: Gustavsen and Semlyen, IEEE Trans. Power Delivery 14(3), 1999).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import torch

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.fit import fit
from torchpi.diagnosis.hypothesis import EffectTerm, Fit, Hypothesis
from torchpi.diagnosis.normal_equations import to_unit_diagonal
from torchpi.diagnosis.score import gain
from torchpi.diagnosis.screen import possible
from torchpi.stage.effects.mechanics.modal import (
    MODAL,
    MOST_MODES,
    ModalCoupling,
    ModalEffect,
    ModalResonance,
    ModalSecondMode,
)
from torchpi.stage.effects.mechanics.modes import RELATIVE_STEP, Modes
from torchpi.stage.effects.mechanics.resonance import peaks_hz

EARNS = 0.5
"""Probability that the recordings are predicted better with a mode, or an input, than without it. For all
modes together, the search demands more."""
LEAST_GAIN = 0.03
"""Minimum share by which one more mode must lower the rms error."""
PER_NUMBER = 1.0
"""Nats that each fitted number gains from noise alone (Akaike, 1974), as no samples are left out here."""
DAMPINGS = (0.01, 0.05)
"""Damping ratios from which a mode is started."""
APART = 0.01
"""Relative frequency offset at which a close second mode is looked for beside a mode."""
TRIED = 3
"""Number of frequencies tried before the residual is taken to contain no further mode."""
STEPS, CLOSING = 3, 12
"""Numbers of Gauss–Newton steps of the poles: after each mode, and at the end."""
FASTEST, MOST_DAMPED = 0.75, 0.29
"""Shares of the sample rate and of critical damping: a pole that moves there is not a mode. A pole beyond the
band may stand for everything beyond it."""
AT_MOST = 12_000
"""Maximum number of samples that the poles are fitted to."""
PASSES = 2
"""Number of passes: in the first the voltage drives the modes, then the fitted hysteresis does."""
RIDGE = 1e-10
"""Regularisation, as a share of each column's sum of squares."""
CLOSED = 1e-3
"""Relative gain of a step below which the refinement of the poles ends."""
LARGEST = 900.0
"""Upper limit of a mode's share of the static gain."""


def driven_modes(chain: Chain, now: Fit, simpler: Sequence[Fit], tolerance: float) -> list[tuple[str, Fit]]:
    """Return a fit with modes and the inputs that drive them added to `now`, and the joint name of these.

    The list is empty if no auxiliary signal was recorded, if none drives a mode, or if `now`, or one of
    `simpler` with fewer parameters, predicts better.
    """
    base = now.hypothesis
    aux = sorted({name for record in chain.records for name in record.aux if np.ptp(record.aux[name]) > 0})
    if not aux or any(issubclass(member.effect, ModalEffect) for member in base.members):
        return []
    for name in MODAL:
        base = base.without(name)
    # Until the hysteresis is fitted with the modes behind it, the voltage is the better drive.
    drive = [chain.voltage(base, i) for i in range(len(chain.records))]
    modes = Superposition(chain, base, drive, aux)
    found: list[tuple[Solved, Fit]] = []
    for _ in range(PASSES):
        start = found[-1][0].poles if found else np.zeros((0, 2))
        solved = modes.found(start)
        if solved is None or not (members := modes.members(solved)):
            break
        hypothesis = modes.base
        for member in members:
            hypothesis = hypothesis.plus(member)
        found.append((solved, fit(chain, hypothesis, now.weights, CLOSING, tolerance)))
        modes = timed(chain, base, found[-1][1].weights, aux, solved.poles)
    found = [(solved, one) for solved, one in found if not one.bounded]
    if not found:
        return []
    density = chain.weighting.log_density
    one = max(found, key=lambda f: float(density(f[1]).sum()))[1]
    if any(density(one).sum() < density(f).sum() for f in (now, *simpler) if not f.bounded):
        return []
    named = [member.effect.name for member in one.hypothesis.members if member.effect in MODAL.values()]
    return [(" + ".join(dict.fromkeys(named)), one)]


def timed(
    chain: Chain, base: Hypothesis, weights: np.ndarray, aux: Sequence[str], poles: np.ndarray
) -> "Superposition":
    """Return modes behind the fitted hysteresis, under the timing convention that suits these poles better:
    with an error of one sample, modes beyond the band are needed to make up for it."""
    found = []
    for alignment in (0, 1):
        other = replace(base, alignment=alignment)
        drive = [chain.displacement(other, weights, i) for i in range(len(chain.records))]
        modes = Superposition(chain, other, drive, aux)
        found.append(
            (float(modes.density(modes.refined(modes.solved(poles, modes.aux), STEPS)).sum()), modes)
        )
    return max(found, key=lambda f: f[0])[1]


@dataclass(frozen=True, eq=False)
class Solved:
    """Poles and the residues solved for with them."""

    poles: np.ndarray
    """(modes, 2): frequency, Hz, and damping ratio."""
    aux: tuple[str, ...]
    coefficients: np.ndarray
    """Coefficients of the static columns, then of both states of each mode per input, mode by mode."""
    columns: np.ndarray
    """(columns, fitted samples)."""
    inverse: np.ndarray
    """Inverse of the columns' Gram matrix."""
    residual: np.ndarray
    """(fitted samples,), µm."""

    @property
    def squares(self) -> float:
        return float(self.residual @ self.residual)


class Superposition:
    """Modes driven by the voltage and by auxiliary signals, beside the static columns.

    Args:
        chain: The recordings.
        base: The hypothesis that precedes the modes.
        drive: (time,) for each recording: the signal of the stage's own axis that drives the modes.
        aux: The signals that may drive a mode.
    """

    def __init__(
        self, chain: Chain, base: Hypothesis, drive: Sequence[np.ndarray], aux: Sequence[str]
    ) -> None:
        self.records, self.base, self.aux = chain.records, base, tuple(aux)
        self.ends = np.cumsum([len(record.y) for record in self.records])
        self.inputs = [
            torch.from_numpy(np.stack([own, *(record.aux[name] for name in self.aux)]))
            for own, record in zip(drive, self.records, strict=True)
        ]
        rows = np.concatenate([chain.rows(base, i)[: base.nominal.kept] for i in range(len(self.records))], 1)
        self.static = np.vstack([np.ones(rows.shape[1]), rows])
        self.driving = np.concatenate([inputs.numpy() for inputs in self.inputs], 1)
        self.weighting = chain.weighting
        fitted = [
            np.flatnonzero(r.train) + end - len(r.y) for r, end in zip(self.records, self.ends, strict=True)
        ]
        joined = np.concatenate(fitted)
        self.fitted = joined[:: -(-len(joined) // AT_MOST)]
        first = np.append(0, self.ends)
        self.fitted_in = [
            self.fitted[(self.fitted >= low) & (self.fitted < high)] - low for low, high in pairwise(first)
        ]
        self.fitted_static = self.static[:, self.fitted]
        self.y = np.concatenate([record.y for record in self.records])

    def found(self, poles: np.ndarray) -> Solved | None:
        """Return as many modes as earn their place, starting from these poles, and the signals that drive
        them; None if there are no modes or no such signals."""
        now = self.refined(self.solved(poles, self.aux), STEPS)
        while len(now.poles) < MOST_MODES:
            more = self.with_one_more(now)
            if more is None:
                break
            now = more
        now = self.without_the_unseen(self.without_the_needless(self.refined(now, CLOSING)))
        now = self.without_the_cancelling(now)
        for name in now.aux:
            less = self.solved(now.poles, tuple(one for one in now.aux if one != name))
            if not self.earns(now, less):
                now = less
        return now if now.aux and len(now.poles) else None

    def with_one_more(self, now: Solved) -> Solved | None:
        """Add the mode that the residual shows best; return None if none earns its place."""
        # Of two modes close together, a single one represents both at first and leaves no peak.
        twins = [float(f) for f in np.outer(now.poles[:, 0], [1 - APART, 1 + APART]).ravel()]
        starts = [(f, damping) for f in [*self.peaks_hz(now), *twins] for damping in DAMPINGS]
        # Each frequency starts with its best damping ratio, and the best frequency comes first.
        starts.sort(key=lambda pole: -self.reduction(now, *pole))
        best = dict(reversed(starts))
        for frequency in list(dict.fromkeys(frequency for frequency, _ in starts))[:TRIED]:
            poles = np.vstack([now.poles, [[frequency, best[frequency]]]])
            more = self.refined(self.solved(poles, now.aux), STEPS)
            # While loud modes are missing, asking that no quiet cell be predicted worse is too strict.
            if self.seen(more).all() and more.squares < (1 - LEAST_GAIN) ** 2 * now.squares:
                return more
        return None

    def reduction(self, now: Solved, frequency_hz: float, damping_ratio: float) -> float:
        """Return by how much one more mode lowers the squared error with the present poles fixed."""
        columns = self.driven(np.array([[frequency_hz, damping_ratio]]), now.aux)
        across = now.columns @ columns.T
        gram = columns @ columns.T - across.T @ now.inverse @ across
        right = columns @ now.residual
        gram[np.diag_indices_from(gram)] += 1e-9 * np.square(columns).sum(1)
        return float(right @ np.linalg.solve(gram, right))

    def without_the_unseen(self, now: Solved) -> Solved:
        """Remove poles that moved to where these samples cannot show a mode, and refine the others."""
        while not (seen := self.seen(now)).all():
            now = self.refined(self.solved(now.poles[seen], now.aux), CLOSING)
        return now

    def without_the_cancelling(self, now: Solved) -> Solved:
        """Remove modes of impossible size: two close together cancel, and one of them is as good."""
        while len(now.poles) and (size := np.abs(self.shares(now)).max(1)).max() >= LARGEST:
            less = self.without_mode(now, int(np.argmax(size)))
            now = self.without_the_unseen(self.refined(less, CLOSING))
        return now

    def without_the_needless(self, now: Solved) -> Solved:
        """Remove modes that are redundant given the others."""
        while len(now.poles):
            least = int(np.argmin(self.losses(now)))
            less = self.refined(self.without_mode(now, least), STEPS)
            if self.earns(now, less):
                break
            now = less
        return now

    def losses(self, now: Solved) -> list[float]:
        """Return the squared error without each of the modes, the other poles fixed."""
        return [self.without_mode(now, m).squares for m in range(len(now.poles))]

    def without_mode(self, now: Solved, mode: int) -> Solved:
        """Solve without one of the modes, the other poles as they are."""
        return self.solved(np.delete(now.poles, mode, 0), now.aux)

    def seen(self, now: Solved) -> np.ndarray:
        """Whether each mode is one that these samples can show, (modes,), bool."""
        lowest, highest = self.limits()
        inside: np.ndarray = np.all((now.poles > 1.001 * lowest) & (now.poles < 0.999 * highest), axis=1)
        return inside

    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest and the highest frequency, Hz, and damping ratio; a pole that hardly decays is a
        line that nothing drives."""
        bounds = [ModalSecondMode.quantities[name] for name in ("frequency_hz", "damping_ratio")]
        highest = [FASTEST * max(record.fs_hz for record in self.records), MOST_DAMPED]
        return np.array([one.at_least for one in bounds]), np.array(highest)

    def peaks_hz(self, now: Solved) -> list[float]:
        """Return the frequencies at which the largest residual of a recording stands out."""
        parts = self.residuals(now)
        loudest = max(range(len(parts)), key=lambda i: float(np.mean(parts[i] ** 2)))
        return peaks_hz(torch.from_numpy(parts[loudest]), self.records[loudest].fs_hz)

    def earns(self, more: Solved, less: Solved) -> bool:
        """Whether the additional modes or inputs of `more` earn their place."""
        numbers = len(more.coefficients) - len(less.coefficients) + 2 * (len(more.poles) - len(less.poles))
        return gain(self.density(more), self.density(less), -PER_NUMBER * numbers).probability > EARNS

    def density(self, now: Solved) -> np.ndarray:
        """Return the log density of each cell, (cells,)."""
        squares = []
        for record, e in zip(self.records, self.residuals(now), strict=True):
            of = record.coefficients
            squares.append(np.bincount(of.cell, of(e[None])[0] ** 2))
        return self.weighting.of_squares(np.concatenate(squares) / self.weighting.counts)

    def residuals(self, now: Solved) -> list[np.ndarray]:
        """Return the residual of each recording, (time,), µm."""
        kept, residues = self.kept(now.aux), self.residues(now)
        static, direct = np.split(now.coefficients[: -residues.size or None], [len(self.static)])
        left = self.y - static @ self.static - direct @ self.driving[kept[1:]]
        return [
            part - np.einsum("mks,kmst->t", residues, states)
            for part, states in zip(
                np.split(left, self.ends[:-1]), self.responses(now.poles, kept), strict=True
            )
        ]

    def solved(self, poles: np.ndarray, aux: tuple[str, ...]) -> Solved:
        """Solve for the residues of every input by least squares."""
        unmoved = [self.fitted_static, self.driving[self.kept(aux)[1:]][:, self.fitted]]
        columns = np.concatenate([*unmoved, self.driven(poles, aux)])
        gram = columns @ columns.T
        unit, scale = to_unit_diagonal(gram, RIDGE)
        inverse = scale[:, None] * np.linalg.inv(unit) * scale
        y = self.y[self.fitted]
        coefficients = inverse @ (columns @ y)
        return Solved(poles, aux, coefficients, columns, inverse, y - coefficients @ columns)

    def driven(self, poles: np.ndarray, aux: tuple[str, ...]) -> np.ndarray:
        """Return both states of each mode for each input, (columns, fitted samples)."""
        kept = self.kept(aux)
        parts = [
            states[..., at] for states, at in zip(self.responses(poles, kept), self.fitted_in, strict=True)
        ]
        joined: np.ndarray = np.concatenate(parts, 3).swapaxes(0, 1).reshape(-1, len(self.fitted))
        return joined

    def responses(self, poles: np.ndarray, kept: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield each mode's displacement and rate for each input, (inputs, modes, 2, time), by recording."""
        frequency_hz, damping_ratio = torch.from_numpy(poles).T
        for record, inputs in zip(self.records, self.inputs, strict=True):
            yield Modes(record.period_s, []).responses(inputs[kept], frequency_hz, damping_ratio).numpy()

    def kept(self, aux: tuple[str, ...]) -> list[int]:
        """Return the indices of these inputs, that of the stage's own axis first."""
        return [0, *(1 + self.aux.index(name) for name in aux)]

    def refined(self, now: Solved, steps: int) -> Solved:
        """Refine the logarithms of the poles by Gauss–Newton, solving for the residues at each step."""
        damping, moving = 1e-3, 2 * len(now.poles)
        for _ in range(steps if moving else 0):
            full = np.concatenate([self.slopes(now), now.columns])
            gram, right = full @ full.T, full @ now.residual
            unit, scale = to_unit_diagonal(gram, RIDGE)
            before = now.squares
            for _ in range(4):
                damped = unit + damping * np.diag(np.arange(len(unit)) < moving)
                step = (scale * np.linalg.solve(damped, scale * right))[:moving].reshape(-1, 2)
                moved = now.poles * np.exp(np.clip(step, [-0.1, -1.0], [0.1, 1.0]))
                trial = self.solved(np.clip(moved, *self.limits()), now.aux)
                if trial.squares < before:
                    now, damping = trial, damping / 10
                    break
                damping = max(10 * damping, 1e-3)
            if now.squares > (1 - CLOSED) * before:
                break
        return now

    def slopes(self, now: Solved) -> np.ndarray:
        """Sensitivity of the output to each log frequency and log damping, (2 modes, fitted samples)."""
        residues = self.residues(now).reshape(len(now.poles), -1)
        here = now.columns[-residues.size :]
        changes = [
            (self.driven(now.poles * (1 + step), now.aux) - here).reshape(*residues.shape, -1)
            for step in RELATIVE_STEP * np.eye(2)
        ]
        slopes = np.stack([np.einsum("mr,mrt->mt", residues, change) for change in changes], 1)
        return slopes.reshape(2 * len(residues), -1) / RELATIVE_STEP

    def residues(self, now: Solved) -> np.ndarray:
        """Return the residues, (modes, inputs, 2)."""
        first = len(self.static) + len(now.aux)
        return now.coefficients[first:].reshape(len(now.poles), 1 + len(now.aux), 2)

    def shares(self, now: Solved) -> np.ndarray:
        """Return the shares of each mode in the static gain, in phase and of the rate, (modes, 2)."""
        residues, own = self.residues(now)[:, 0], now.coefficients[: len(self.static)]
        centred = self.driving[0] - self.driving[0].mean()
        static = own @ self.static @ centred / max(centred @ centred, 1e-300) + residues[:, 0].sum()
        with np.errstate(divide="ignore", invalid="ignore"):
            shares: np.ndarray = residues / static
        return shares

    def members(self, now: Solved) -> list[EffectTerm]:
        """Return the result as named effects; the mode that it can least do without is the resonance.

        The list is empty if the numbers are impossible for a stage, as recordings in extreme units may give.
        """
        residues, shares = self.residues(now), self.shares(now)
        direct = now.coefficients[len(self.static) :][: len(now.aux)]
        strongest = int(np.argmax(self.losses(now)))
        order = [strongest, *(int(m) for m in np.argsort(now.poles[:, 0]) if m != strongest)]
        found: list[EffectTerm] = []
        for m in order:
            effect = ModalResonance if m == strongest else ModalSecondMode
            names = ("frequency_hz", "damping_ratio", "share", "rate_share")
            numbers = map(float, (*now.poles[m], *shares[m]))
            found.append(EffectTerm(effect, dict(zip(names, numbers, strict=True))))
        for k, name in enumerate(now.aux):
            values = {"coupling_um_per_v": float(direct[k] + residues[:, k + 1, 0].sum())}
            for number, m in enumerate(order, 1):
                values[f"mode{number}_um_per_v"] = float(residues[m, k + 1, 0])
                values[f"mode{number}_rate_um_per_v"] = float(residues[m, k + 1, 1])
            found.append(EffectTerm(ModalCoupling, values, aux=name))
        return found if all(possible(member.effect, member.shared) for member in found) else []
