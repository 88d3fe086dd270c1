"""Time the paper's two-stage identification, 5,000 points each: torchpi against scripts a user would write.

    python benchmarks/identification.py [--stage configs/stage/qin2013.yaml] [--repeats 9] [--joint]

All fit the same parameters, 10 plays and a polynomial of degree 4, to the same records of the simulated
stage: a 5 Hz sine for stage 1 (eq. 10) and the multisine of eq. 13 for stage 2 (eq. 11).

The plain script uses NumPy, vectorised over the plays with a loop over samples, and scipy.optimize's
least_squares with finite differences over all 14 parameters of stage 1; its stage 2 is one linear
least-squares problem. Every method and scaling of SciPy is tried, with y in µm and with y scaled to 1. The
stronger script solves for the weights at each trial of the 4 coefficients, still with finite differences.

`--joint` adds half a minute: the joint fit of all parameters against L-BFGS on the same projected loss.
"""

import argparse
import copy
import statistics
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy.optimize
import torch

from torchpi.control.direct_inverse import DirectInverse
from torchpi.excitation.signals import paper_multisine, sine_5hz
from torchpi.identification import InversePair, fit_joint, fit_two_stage, inverse_pair, searched_parameters
from torchpi.identification.projection import projected_loss
from torchpi.paper.fig10 import paper_form
from torchpi.paper.recipe import stage_recordings
from torchpi.paper.tracking import record
from torchpi.stage import Stage

POINTS = 5_000
DEGREE = 4
R = np.array([0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 1.5, 2.0, 3.0])  # the paper's thresholds


class Fit(NamedTuple):
    seconds: float
    slow_mv: float  # rms
    fast_mv: float
    times_ours: float = 1.0

    @property
    def both_mv(self) -> float:
        return float(np.hypot(self.slow_mv, self.fast_mv) / np.sqrt(2))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--stage", type=Path, default=Path("configs/stage/qin2013.yaml"))
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--joint", action="store_true", help="compare the fit of everything at once too")
    options = parser.parse_args()
    torch.set_num_threads(1)
    stage = Stage.from_yaml(options.stage).requires_grad_(False)
    slow, fast = (
        inverse_pair(record(stage, name, excite(POINTS / stage.sample_rate_hz, stage.sample_rate_hz), seed))
        for seed, (name, excite) in enumerate({"5 Hz sine": sine_5hz, "eq. 13": paper_multisine}.items())
    )

    first = _ours(slow, fast)
    ours = [_ours(slow, fast) for _ in range(options.repeats)]

    def beside_ours(fit: Callable[[], Fit]) -> Fit:
        """Time a fit between runs of torchpi's, so that other load on the machine slows both."""
        before = ours[-options.repeats :]
        found = fit()
        ours.extend(_ours(slow, fast) for _ in range(options.repeats))
        median_s = statistics.median(one.seconds for one in before + ours[-options.repeats :])
        return found._replace(times_ours=found.seconds / median_s)

    plain = {
        f"plain, {method}, x_scale {x_scale}, y in {unit}": beside_ours(
            partial(_plain, slow, fast, method, x_scale, scale)
        )
        for unit, scale in (("µm", 1.0), ("ranges", float(slow.motion.yd.max())))
        for method in ("trf", "dogbox", "lm")
        for x_scale in (1.0, "jac")
    }
    stronger = {
        f"weights solved for, {method}": beside_ours(partial(_weights_solved_for, slow, fast, method))
        for method in ("trf", "dogbox", "lm")
    }
    torchpi = ours[0]._replace(seconds=statistics.median(one.seconds for one in ours))

    print(f"two stages, {POINTS:,} points each, {len(R)} plays, degree {DEGREE}; errors are rms")
    print(f"{'':48}{'time, s':>9}{'stage 1, mV':>13}{'stage 2, mV':>13}{'both, mV':>10}{'× torchpi':>11}")
    for name, fit in {"torchpi": torchpi, **plain, **stronger}.items():
        print(
            f"{name:48}{fit.seconds:9.3f}{fit.slow_mv:13.2f}{fit.fast_mv:13.2f}{fit.both_mv:10.2f}"
            f"{fit.times_ours:11,.0f}"
        )
    print(f"torchpi, first call of the process, kernels loaded or compiled: {first.seconds:.2f} s")
    for name, group in (("plain", plain), ("stronger", stronger)):
        times = [fit.times_ours for fit in group.values()]
        least = min(fit.both_mv for fit in group.values())
        print(
            f"{name} script, all settings: {min(times):,.0f} to {max(times):,.0f} × the time, "
            f"{statistics.median(times):,.0f} in the middle; best error {least / torchpi.both_mv:.3f} ×"
        )
    if options.joint:
        _joint(stage)


def _joint(stage: Stage) -> None:
    """Fit all parameters jointly to six records: lead, creep with a pole of 1 ms, 14 and 20 plays."""
    recordings = stage_recordings(stage)
    pairs = [inverse_pair(recording, 2, 1000.0) for recording in recordings]
    thinned = [pair._replace(counted=slice(0, pair.counted.stop, 5)) for pair in pairs]
    largest = max(float(np.ptp(recording.y)) for recording in recordings)
    print(f"\n{'all at once, 200 evaluations':48}{'time, s':>9}{'rms, mV':>10}")
    for plays in (14, 20):
        start = DirectInverse(
            pairs[0].sample_period_s,
            [0.92 * largest * (i / (plays - 1)) ** 2 for i in range(plays)],
            output_degree=2,
            lead=2,
            creep_time_constants_s=[0.001, 0.01, 0.1, 1.0],
            range_um=largest,
            rate_scale_um_s=max(float(pair.motion.yd_dot.abs().max()) for pair in pairs),
        )
        fit_two_stage(start, pairs)
        for name, fit in {"torchpi": fit_joint, "L-BFGS": _lbfgs}.items():
            fitted = copy.deepcopy(start)
            began = time.perf_counter()
            rms_v = fit(fitted, thinned, 200)
            print(
                f"{name}, {plays} plays".ljust(48) + f"{time.perf_counter() - began:9.2f}{1e3 * rms_v:10.2f}"
            )


def _lbfgs(compensator: DirectInverse, pairs: Sequence[InversePair], evaluations: int) -> float:
    problem = [pair.motion for pair in pairs], [pair.u for pair in pairs], [pair.counted for pair in pairs]
    optimizer = torch.optim.LBFGS(
        searched_parameters(compensator, weights_are_solved=True),
        max_iter=evaluations,
        max_eval=evaluations,
        history_size=20,
        tolerance_grad=1e-10,
        tolerance_change=1e-13,
        line_search_fn="strong_wolfe",
    )
    scale = projected_loss(compensator, *problem).item()

    def closure() -> torch.Tensor:
        optimizer.zero_grad()
        loss = projected_loss(compensator, *problem) / scale
        loss.backward()
        return loss

    optimizer.step(closure)
    with torch.no_grad():
        return float(projected_loss(compensator, *problem).sqrt())


def _ours(slow: InversePair, fast: InversePair) -> Fit:
    compensator: DirectInverse = paper_form((slow, fast), slow.sample_period_s)
    start = time.perf_counter()
    found = fit_two_stage(compensator, [slow, fast])
    return Fit(time.perf_counter() - start, 1e3 * found.slow_rms_v, 1e3 * found.fast_rms_v)


def _play_states(s: np.ndarray) -> np.ndarray:
    low, high = s[:, None] - R, s[:, None] + R
    h = np.zeros(len(R))
    states = np.empty_like(low)
    for t in range(len(s)):
        h = np.maximum(low[t], np.minimum(high[t], h))
        states[t] = h
    return states


def _saturation(c: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.polyval([*c[::-1], 0.0], y)


def _signals(pair: InversePair, scale: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return pair.motion.yd[0].numpy() / scale, pair.motion.yd_dot[0].numpy(), pair.u[0].numpy()


def _plain(slow: InversePair, fast: InversePair, method: str, x_scale: float | str, scale: float) -> Fit:
    start = time.perf_counter()
    y, _, u = _signals(slow, scale)

    def residual(numbers: np.ndarray) -> np.ndarray:
        return _play_states(_saturation(numbers[:DEGREE], y)) @ numbers[DEGREE:] - u

    # Start from S(y) = y in µm, with all of the gain on the first play.
    guess = np.zeros(DEGREE + len(R))
    guess[0], guess[DEGREE] = scale, u.max() / (scale * y.max())
    found = scipy.optimize.least_squares(residual, guess, method=method, x_scale=x_scale)
    return _second_stage(start, found.x[:DEGREE], found.fun, fast, scale)


def _weights_solved_for(slow: InversePair, fast: InversePair, method: str) -> Fit:
    start = time.perf_counter()
    scale = float(slow.motion.yd.max())
    y, _, u = _signals(slow, scale)

    def residual(c: np.ndarray) -> np.ndarray:
        h = _play_states(_saturation(c, y))
        return np.asarray(h @ np.linalg.lstsq(h, u, rcond=None)[0] - u)

    found = scipy.optimize.least_squares(residual, scale * np.eye(DEGREE)[0], method=method)
    return _second_stage(start, found.x, found.fun, fast, scale)


def _second_stage(
    start: float, c: np.ndarray, slow_error: np.ndarray, fast: InversePair, scale: float
) -> Fit:
    y, rate, u = _signals(fast, scale)
    h = _play_states(_saturation(c, y))
    columns = np.concatenate([h, h * (rate / np.abs(rate).max())[:, None]], 1)
    error = columns @ np.linalg.lstsq(columns, u, rcond=None)[0] - u
    seconds = time.perf_counter() - start
    return Fit(seconds, 1e3 * _rms(slow_error), 1e3 * _rms(error))


def _rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error**2)))


if __name__ == "__main__":
    main()
