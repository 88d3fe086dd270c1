"""Contribution of each part of torchpi's compensator: same recordings, one part more or less at a time."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from torchpi.control.direct_inverse import DirectInverse
from torchpi.paper.fig8 import FREQUENCIES_HZ, deployed
from torchpi.paper.methods import tracked
from torchpi.paper.recipe import BANDWIDTH_HZ, FORM, fig7_compensator, learn, stage_recordings
from torchpi.paper.tracking import InOnePass, TrackingError
from torchpi.stage import Stage

PAPER = {"output_degree": 1, "preview": 0, "lead": 0, "creep_time_constants_s": []}
# In the order of the table: first the parts added one by one, then the full form with one part changed.
VARIANTS: dict[str, dict[str, Any]] = {
    "two stages, the paper's form": {"form": PAPER, "evaluations": 0},
    "trained jointly": {"form": PAPER},
    "+ look-ahead": {"form": {**PAPER, "preview": 2}},
    "+ lead": {"form": {**PAPER, "preview": 2, "lead": 2}},
    "+ creep": {"form": {**FORM, "output_degree": 1}},
    "+ own output functions: torchpi": {"form": FORM},
    "torchpi without joint training": {"form": FORM, "evaluations": 0},
    "torchpi, neural rate head": {"form": {**FORM, "rate": "neural"}},
    "torchpi, weights that ignore the rate": {"form": {**FORM, "rate": "none"}},
    "torchpi, rates up to 4 kHz": {"form": FORM, "bandwidth_hz": 4.0 * BANDWIDTH_HZ},
}
PASSES = (0, 1, 2, 4)


@dataclass(frozen=True)
class Spread:
    """Statistics of one number over the seeds."""

    mean: float
    least: float
    most: float


@dataclass(frozen=True)
class Ablation:
    """Errors of every variant, over seeds of the phases and of the noise.

    Attributes:
        stage: Per cent of peak to peak, by variant and by `slow_max`, `slow_rms`, `fast_max`, `fast_rms`.
        fig7: Max error of the corrected inverse in % of 9 µm, by number of passes and frequency.
        seeds: Number of seeds.
    """

    stage: dict[str, dict[str, Spread]]
    fig7: dict[str, dict[str, float]]
    seeds: int


def ablation(
    stage: Stage,
    seeds: int = 2,
    variants: Mapping[str, Mapping[str, Any]] = VARIANTS,
    passes: Sequence[int] = PASSES,
    log: Callable[[str], None] = lambda text: None,
) -> Ablation:
    """For every seed, train every variant on the same recordings and let it track eq. 15 and 16."""
    found: dict[str, list[dict[str, TrackingError]]] = {name: [] for name in variants}
    for seed in range(seeds):
        recordings = stage_recordings(stage, seed)
        for name, settings in variants.items():
            log(f"{name}, seed {seed + 1} of {seeds}")
            compensator: DirectInverse = learn(
                recordings, stage.min_voltage_v, stage.max_voltage_v, **settings
            )
            found[name].append(tracked(stage, {name: InOnePass(compensator)})[name])
    fig7 = {}
    for count in passes:
        log(f"Fig. 7 plant, {count} passes")
        corrected = InOnePass(fig7_compensator(count))
        fig7[str(count)] = {str(hz): deployed(corrected, hz).max_percent for hz in FREQUENCIES_HZ}
    return Ablation({name: _spreads(errors) for name, errors in found.items()}, fig7, seeds)


def _spreads(errors: Sequence[Mapping[str, TrackingError]]) -> dict[str, Spread]:
    spreads = {}
    for trajectory in ("slow", "fast"):
        for kind in ("max", "rms"):
            values = np.array([getattr(each[trajectory], f"{kind}_percent") for each in errors])
            spread = Spread(float(values.mean()), float(values.min()), float(values.max()))
            spreads[f"{trajectory}_{kind}"] = spread
    return spreads
