"""Fit each of the compensators in `torchpi.control.indirect` to the same recordings.

Forward models are fitted from voltage to displacement. The inverse saturation S⁻¹ is linear in its parameters
too (Kuhnen 2003), so plays and dead zones come from one bounded least-squares problem:

    Σ_i w_i H_ri[u] = S⁻¹(y) = y + Σ_j v_j S_dj(y),   w_i ≥ 0

S is fitted to the slow record alone, as the paper does with its polynomial; rate-dependent parameters are
fitted to the fast records.
"""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
import scipy.optimize
import torch

from torchpi.control.indirect.base import IndirectInverse
from torchpi.control.indirect.cascade import CascadedInverse
from torchpi.control.indirect.conventional import ConventionalInverse
from torchpi.control.indirect.generalised_direct import GeneralisedDirectInverse
from torchpi.control.indirect.rate_dependent import RateDependentInverse
from torchpi.control.indirect.time_varying_thresholds import TimeVaryingThresholdInverse
from torchpi.errors import ConfigError
from torchpi.identification.pair import InversePair
from torchpi.operators.dead_zone import DeadZones
from torchpi.operators.generalised_play import GeneralisedPlayBank, clamp_bank
from torchpi.operators.play import PlayBank

Model = TypeVar("Model", bound=IndirectInverse)
LEAST_WEIGHT = 1e-3  # least first weight, relative to the record's µm per V: an inverse needs it above 0


class Records:
    """A slow record, faster records, and what all fits share.

    Args:
        slow: Record for the rate-independent parameters.
        fast: Records for the rate-dependent parameters; the slow record if there are none.
        thresholds: r of the forward models, V, rising from 0.
        dead_zones: Thresholds d of the saturation, µm, one of them 0; [0] means no saturation.
        preview: Look-ahead with which the pairs were made, samples; passed on to the compensators.
        min_voltage_v: Lower output limit of the compensators.
        max_voltage_v: Upper output limit.

    Raises:
        ConfigError: The fitted saturation has no inverse: fewer dead zones are needed.
    """

    def __init__(
        self,
        slow: InversePair,
        fast: Sequence[InversePair],
        thresholds: Sequence[float],
        dead_zones: Sequence[float] = (0.0,),
        preview: int = 0,
        min_voltage_v: float = 0.0,
        max_voltage_v: float = 10.0,
    ) -> None:
        self.slow, self.fast = slow, list(fast) or [slow]
        self.r = list(thresholds)
        self.deployment: dict[str, Any] = {
            "preview": preview,
            "min_voltage_v": min_voltage_v,
            "max_voltage_v": max_voltage_v,
        }
        self.period_s = slow.sample_period_s
        self.floor = LEAST_WEIGHT * float(np.ptp(slow.motion.yd.numpy()) / np.ptp(slow.u.numpy()))

        zones = DeadZones(list(dead_zones), [1.0] * len(dead_zones))
        others = zones.d != 0
        plays = self.plays(slow)
        found = self.solve(
            [np.concatenate([plays, -zones.pieces(slow.motion.yd)[0][:, others].numpy()], 1)],
            [slow.motion.yd[0].numpy()],
            [slow],
            bounded=len(self.r),
        )
        self.w: list[float] = found[: len(self.r)].tolist()
        v = torch.ones(len(zones.d), dtype=torch.float64)
        v[others] = torch.from_numpy(found[len(self.r) :])
        self.unsaturated = DeadZones(zones.d.tolist(), v.tolist())
        try:
            self.saturation = self.unsaturated.inverse()
        except ConfigError as error:
            raise ConfigError(f"{slow.name}: {error}; use fewer dead zones") from error

    def plays(self, pair: InversePair) -> np.ndarray:  # (time, plays)
        """Return the play states H_r[u]."""
        with torch.no_grad():
            return np.asarray(PlayBank(self.r)(pair.u)[0][0].numpy())

    def straightened(self, pair: InversePair) -> np.ndarray:  # (time,), µm
        """Return S⁻¹(y)."""
        with torch.no_grad():
            return np.asarray(self.unsaturated(pair.motion.yd)[0][0].numpy())

    def solve(
        self,
        columns: Sequence[np.ndarray],
        target: Sequence[np.ndarray],
        pairs: Sequence[InversePair],
        bounded: int = 0,  # how many of the first coefficients must not be negative
    ) -> np.ndarray:
        """Solve least squares over the counted samples of the records, with columns scaled to equal norm."""
        a = np.concatenate([part[pair.counted] for part, pair in zip(columns, pairs, strict=True)])
        b = np.concatenate([part[pair.counted] for part, pair in zip(target, pairs, strict=True)])
        size = np.linalg.norm(a, axis=0)
        size[size == 0] = 1.0
        low = np.full(a.shape[1], -np.inf)
        low[:bounded] = 0.0
        low[:1] = self.floor * size[0] if bounded else -np.inf
        # The R factor replaces the record in the solver: a hundred rows instead of a hundred thousand.
        q, triangle = np.linalg.qr(a / size)
        found = scipy.optimize.lsq_linear(triangle, q.T @ b, (low, np.inf), tol=1e-12, max_iter=500)
        return np.asarray(found.x / size)

    def rate_weights(
        self,
        states: Callable[[InversePair], np.ndarray],  # (time, plays)
        target: Sequence[np.ndarray],  # (time,) of each fast record
        bounded: int = 0,
    ) -> tuple[list[float], list[float]]:
        """Fit b and k of Σ_i (b_i + k_i ẏ) h_i to the fast records."""
        columns = []
        for pair in self.fast:
            h = states(pair)
            columns.append(np.concatenate([h, h * pair.motion.yd_dot[0].numpy()[:, None]], 1))
        b, k = np.split(self.solve(columns, target, self.fast, bounded), 2)
        return b.tolist(), k.tolist()

    def inverse(self, kind: type[Model], weights: list[float], **more: list[float]) -> Model:
        """Return a compensator of this kind, with the thresholds and the saturation that all share."""
        given: dict[str, Any] = {"saturation": self.saturation, **more, **self.deployment}
        return kind(self.period_s, self.r, weights, **given)


def fit_conventional(records: Records) -> ConventionalInverse:
    """Fit a rate-independent model to the slow record."""
    return records.inverse(ConventionalInverse, records.w)


def fit_rate_dependent(records: Records) -> RateDependentInverse:
    """Fit weights k ẏ + b to the fast records: Σ_i (b_i + k_i ẏ) H_ri[u] = S⁻¹(y)."""
    target = [records.straightened(pair) for pair in records.fast]
    b, k = records.rate_weights(records.plays, target, bounded=len(records.r))
    return records.inverse(RateDependentInverse, b, weight_slopes=k)


def fit_time_varying_thresholds(records: Records) -> TimeVaryingThresholdInverse:
    """Fit thresholds r_i + ρ|ẏ| to the fast records, with one ρ for all but the first, which is constant."""
    r = torch.tensor(records.r, dtype=torch.float64)
    moving = (torch.arange(len(r)) > 0).to(torch.float64)
    target = [records.straightened(pair) for pair in records.fast]
    top_rate = max(float(pair.motion.yd_dot.abs().max()) for pair in records.fast)

    def columns(rho: float) -> list[np.ndarray]:
        banks = []
        for pair in records.fast:
            now = r + rho * moving * pair.motion.yd_dot.abs()[..., None]
            h0 = torch.zeros(1, len(r), dtype=torch.float64)
            banks.append(clamp_bank(pair.u[..., None] - now, pair.u[..., None] + now, h0)[0].numpy())
        return banks

    def left(rho: float) -> float:
        banks = columns(rho)
        w = records.solve(banks, target, records.fast, bounded=len(r))
        return sum(
            float(np.sum(((bank @ w - y)[pair.counted]) ** 2))
            for bank, y, pair in zip(banks, target, records.fast, strict=True)
        )

    # Upper bound of ρ: at the fastest motion, thresholds grow by half of the largest one.
    most = 0.5 * records.r[-1] / top_rate
    rho = float(scipy.optimize.minimize_scalar(left, bounds=(0.0, most), method="bounded").x)
    w = records.solve(columns(rho), target, records.fast, bounded=len(r))
    return records.inverse(TimeVaryingThresholdInverse, w.tolist(), threshold_slopes=(rho * moving).tolist())


def fit_cascade(records: Records, order: int = 2) -> CascadedInverse:
    """Fit τ to the fast records, the hysteresis to the slow one: y + τ_1 ẏ + τ_2 ÿ = S(Σ_i w_i H_ri[u])."""
    columns, target = [], []
    for pair in records.fast:
        derivatives = [part[0].numpy() for part in pair.motion[1 : 1 + order]]
        columns.append(np.stack(derivatives, 1))
        with torch.no_grad():
            plays = torch.from_numpy(records.plays(pair) @ np.array(records.w))
            statically, _ = records.saturation(plays[None])
        target.append(statically[0].numpy() - pair.motion.yd[0].numpy())
    lead = records.solve(columns, target, records.fast)
    return records.inverse(CascadedInverse, records.w, lead=lead.tolist())


def fit_generalised_direct(
    records: Records,
    thresholds: Sequence[float],  # r of the inverse's plays, µm
    degree: int = 3,
) -> GeneralisedDirectInverse:
    """Fit envelopes to the slow record by variable projection, then k and b to the fast records.

    A single envelope for both directions is searched first, which is the paper's stage 1. The search for two
    envelopes starts from it, so its fit to the slow record is at least as good.
    """
    size = float(records.slow.motion.yd.max())
    powers = size ** np.arange(degree)
    r = list(thresholds)

    def bank(scaled: np.ndarray) -> GeneralisedPlayBank:
        up, down = scaled[:degree] / powers, scaled[-degree:] / powers
        return GeneralisedPlayBank(r, r, up.tolist(), down.tolist(), size)

    def states(plays: GeneralisedPlayBank, pair: InversePair) -> np.ndarray:
        with torch.no_grad():
            return np.asarray(plays(pair.motion.yd)[0][0].numpy())

    def residual(scaled: np.ndarray) -> np.ndarray:
        h, u = states(bank(scaled), records.slow), records.slow.u[0].numpy()
        w = records.solve([h], [u], [records.slow])
        return np.asarray((h @ w - u)[records.slow.counted])

    def search(start: np.ndarray) -> np.ndarray:
        steps = [1e-5] * len(start)
        found = scipy.optimize.least_squares(residual, start, diff_step=steps, max_nfev=60)
        return np.asarray(found.x)

    plays = bank(search(np.tile(search(np.eye(degree)[0]), 2)))
    b, k = records.rate_weights(
        lambda pair: states(plays, pair), [pair.u[0].numpy() for pair in records.fast]
    )
    return GeneralisedDirectInverse(records.period_s, plays, k, b, **records.deployment)
