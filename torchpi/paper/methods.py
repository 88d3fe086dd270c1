"""A table of all methods that the paper names, fitted to the same recordings and run on the same motions.

The recordings are the paper's two, 5 Hz sine and eq. 13. A method sees nothing else of the plant, so that its
row shows the merit of its form, independent of any knowledge of the plant.
"""

from collections.abc import Callable
from typing import Any

import torch

from torchpi.excitation.trajectory import load_trajectory
from torchpi.identification import fit_two_stage, inverse_pair
from torchpi.identification.indirect import (
    Records,
    fit_cascade,
    fit_conventional,
    fit_generalised_direct,
    fit_rate_dependent,
    fit_time_varying_thresholds,
)
from torchpi.operators.motion import backward_motion
from torchpi.paper import fig7_plant, fig8, fig12
from torchpi.paper.fig7_plant import Fig7Plant
from torchpi.paper.fig10 import THRESHOLDS, identify, paper_form
from torchpi.paper.tracking import Deployed, InOnePass, Plant, StraightLine, TrackingError

# For the stage: r of the forward models, V, denser near reversals, and dead zones of their saturation, µm.
STAGE_THRESHOLDS_V = [0.0, 0.05, 0.1, 0.2, 0.35, 0.6, 1.0, 1.5, 2.0, 3.0, 4.0]
STAGE_DEAD_ZONES_UM = [0.0, 2.0, 4.0, 6.0]

METHODS: dict[str, Callable[[Records], Any]] = {
    "conventional": fit_conventional,
    "rate_dependent": fit_rate_dependent,
    "time_varying_thresholds": fit_time_varying_thresholds,
    "cascade": fit_cascade,
    "generalised_direct": lambda records: fit_generalised_direct(records, THRESHOLDS),
}
LABELS = {
    "without": "straight line, no compensation",
    "conventional": "conventional inverse (Krejčí–Kuhnen)",
    "rate_dependent": "rate-dependent terms put in (Ang, Tan)",
    "known_plant": "the same, with the plant's own numbers (Fig. 8)",
    "time_varying_thresholds": "time-varying thresholds (Al Janaideh–Krejčí)",
    "cascade": "hysteresis in cascade with linear dynamics (Croft–Devasia)",
    "generalised_direct": "direct, generalised plays",
    "paper": "direct, two stages (the paper)",
    "torchpi": "torchpi",
}


def fitted_to_fig7() -> dict[str, Deployed]:
    """Fit every method, the straight line and the paper's to the two recordings of the Fig. 7 plant."""
    plant = Fig7Plant()
    identified = identify(plant)
    limits: dict[str, Any] = {"min_voltage_v": plant.min_voltage_v, "max_voltage_v": plant.max_voltage_v}
    # The plant needs less than 0 V to come down to 1 µm.
    paper = identified.compensator
    paper.min_voltage_v, paper.max_voltage_v = plant.min_voltage_v, plant.max_voltage_v
    slow, fast = identified.pairs
    records = Records(slow, [fast], fig7_plant.THRESHOLDS, **limits)
    return {
        "without": StraightLine(identified.slow, 0, plant.min_voltage_v, plant.max_voltage_v),
        **{name: InOnePass(fit(records)) for name, fit in METHODS.items()},
        "paper": InOnePass(paper),
    }


def on_fig7(compensator: Deployed) -> dict[str, float]:
    """Return the steady-state errors on the sines of eq. 9, % of 9 µm, by frequency."""
    return {str(hz): fig8.deployed(compensator, hz).max_percent for hz in fig8.FREQUENCIES_HZ}


def fitted_to_stage(plant: Plant, preview: int) -> dict[str, Deployed]:
    """Fit the same methods to the stage, with its recordings seen `preview` samples ahead."""
    identified = identify(plant)
    slow, fast = (inverse_pair(recording, preview) for recording in (identified.slow, identified.fast))
    records = Records(slow, [fast], STAGE_THRESHOLDS_V, STAGE_DEAD_ZONES_UM, preview)
    paper = paper_form((slow, fast), plant.sample_period_s, preview)
    fit_two_stage(paper, [slow, fast], several_starts=False)
    return {
        "without": StraightLine(identified.slow, preview),
        **{name: InOnePass(fit(records)) for name, fit in METHODS.items()},
        "paper": InOnePass(paper),
    }


def tracked(plant: Plant, compensators: dict[str, Deployed]) -> dict[str, dict[str, TrackingError]]:
    """Return the errors of tracking eq. 15 and 16, by method, then by trajectory."""
    panels = {name: fig12.panel(plant, name, compensators) for name in fig12.TRAJECTORIES}
    return {
        method: {name: panel.tracked[method].error for name, panel in panels.items()}
        for method in compensators
    }


def dilation_on_fast(plant: Plant) -> str:
    """State whether the thresholds on eq. 16 meet the condition under which the formula is exact."""
    identified = identify(plant)
    slow, fast = identified.pairs
    inverse = fit_time_varying_thresholds(Records(slow, [fast], STAGE_THRESHOLDS_V, STAGE_DEAD_ZONES_UM))
    yd = load_trajectory("fast", fs_hz=plant.sample_rate_hz).yd
    motion = backward_motion(torch.from_numpy(yd)[None], plant.sample_period_s)
    return str(inverse.dilation(motion))
