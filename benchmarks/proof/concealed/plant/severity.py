"""Severity: how much an effect changes the recordings; and the strength that reaches a wanted severity."""

import math
from collections.abc import Callable, Sequence

import numpy as np
from concealed.plant.physics import Array, Physics
from concealed.plant.rig import Rig, Run, simulate


def severity(rig: Rig, physics: Physics, runs: Sequence[Run], plain: Array | None = None) -> float:
    """Rms over all runs of (with - without) after a best gain and offset, in units of the noise."""
    without = readings(rig, Physics(), runs) if plain is None else plain
    return misfit_um(readings(rig, physics, runs), without) / rig.noise_um


def readings(rig: Rig, physics: Physics, runs: Sequence[Run]) -> Array:
    """Every run's readings end to end, without noise, µm."""
    return np.concatenate([simulate(rig, physics, run) for run in runs])


def misfit_um(with_effect: Array, without: Array) -> float:
    """Rms of the difference that remains after fitting a gain and an offset."""
    x = without - without.mean()
    y = with_effect - with_effect.mean()
    return float(np.sqrt(np.mean((y - x * (x @ y) / (x @ x)) ** 2)))


def strength_for(
    wanted: float, measure: Callable[[float], float], low: float, high: float, start: float
) -> tuple[float, float]:
    """Return the strength in [low, high] with the wanted severity, and the severity reached.

    Takes secant steps in the logarithms of both until two strengths enclose it, then interpolates and bisects
    in turn; gives the nearest found if the bounds exclude it. Severity may grow or fall with strength.
    """
    goal = math.log(wanted)
    ends = [math.log(low), math.log(high)]
    tried: dict[float, float] = {}
    s = min(max(math.log(start), ends[0]), ends[1])
    for _ in range(14):
        tried[s] = math.log(max(measure(math.exp(s)), 1e-2))
        if abs(tried[s] - goal) < 0.05:
            break
        s = _next(tried, goal, ends)
        if min(abs(s - t) for t in tried) < 1e-4:
            break
    best = min(tried, key=lambda t: abs(tried[t] - goal))
    return math.exp(best), math.exp(tried[best])


def _next(tried: dict[float, float], goal: float, ends: list[float]) -> float:
    below = [t for t in tried if tried[t] < goal]
    above = [t for t in tried if tried[t] >= goal]
    if below and above:
        a, b = min(((a, b) for a in below for b in above), key=lambda pair: abs(pair[0] - pair[1]))
        weight = (goal - tried[a]) / (tried[b] - tried[a]) if len(tried) % 2 else 0.5
        return a + min(max(weight, 0.1), 0.9) * (b - a)
    nearest = min(tried, key=lambda t: abs(tried[t] - goal))
    slope = 1.0
    if len(tried) > 1:
        other = min((t for t in tried if t != nearest), key=lambda t: abs(t - nearest))
        slope = (tried[nearest] - tried[other]) / (nearest - other)
        slope = math.copysign(max(abs(slope), 0.1), slope)
    step = (goal - tried[nearest]) / slope
    return min(max(nearest + min(max(step, -3.0), 3.0), ends[0]), ends[1])
