"""Unseen trajectories, for which nothing was tuned: random phases over the band of eq. 15 and 16."""

from dataclasses import dataclass

import numpy as np
import torch

from torchpi.excitation.signals import random_trajectory
from torchpi.operators.reference_filter import ReferenceFilter
from torchpi.paper.tracking import Deployed, Plant, TrackingError, follow, tracking_error

COUNT = 10
BAND_HZ = (1.0, 50.0)  # from the slowest line of eq. 15 to the fastest of eq. 16
RANGE_UM = (1.0, 7.0)
FIRST_SEED = 100


@dataclass(frozen=True)
class Trial:
    """Result on one random trajectory."""

    seed: int
    top_rate_um_s: float
    error: TrackingError
    on_sensor: TrackingError


def trial(compensator: Deployed, plant: Plant, seed: int, duration_s: float = 2.0) -> Trial:
    """Track a random trajectory, passed through the reference filter as in the paper."""
    rate_hz = plant.sample_rate_hz
    _, yr = random_trajectory(duration_s, rate_hz, *RANGE_UM, *BAND_HZ, seed=seed)
    motion = ReferenceFilter(1 / rate_hz)(torch.from_numpy(yr)[None])
    yd = motion.yd[0].numpy()
    run = follow(compensator, plant, yd)
    return Trial(
        seed,
        float(motion.yd_dot.abs().max()),
        tracking_error(run.y, yd, float(np.ptp(yr))),
        tracking_error(run.reading, yd, float(np.ptp(yr))),
    )


def median_and_worst(trials: list[Trial], attribute: str) -> tuple[float, float]:
    """Return median and maximum of one attribute of the errors on the true displacement."""
    values = [getattr(one.error, attribute) for one in trials]
    return float(np.median(values)), float(np.max(values))
