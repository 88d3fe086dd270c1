"""Fig. 12, Qin et al. (2013): tracking of the slow (eq. 15) and the fast (eq. 16) trajectory.

Both pass the reference filter (eq. 14) and start from rest on a de-energised stage. The error is that of the
true displacement; the error of the sensor reading is given beside it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from torchpi.excitation.trajectory import Trajectory, load_trajectory
from torchpi.loop.result import loading_samples
from torchpi.paper.tracking import Deployed, Plant, TrackingError, follow, tracking_error

TRAJECTORIES = ("slow", "fast")


@dataclass(frozen=True)
class Tracked:
    """Result of one compensator on one trajectory."""

    u: np.ndarray  # (time,), V
    y: np.ndarray  # (time,), µm
    error: TrackingError
    on_sensor: TrackingError
    samples_at_limit: int  # number of samples with the voltage at a limit


@dataclass(frozen=True)
class Panel:
    """Results on one trajectory."""

    t: np.ndarray  # (time,), s
    yd: np.ndarray  # (time,), µm
    peak_to_peak_um: float  # of y_r: 6 and 6.83 µm
    loading_s: float
    tracked: dict[str, Tracked]  # by the name of the method


def panel(plant: Plant, trajectory: str, compensators: Mapping[str, Deployed]) -> Panel:
    """Run each compensator along `trajectory`, slow or fast, each from the de-energised state."""
    reference = _reference(trajectory, plant.sample_rate_hz)
    peak_to_peak_um = float(np.ptp(reference.yr))
    tracked = {}
    for name, compensator in compensators.items():
        run = follow(compensator, plant, reference.yd)
        tracked[name] = Tracked(
            run.u,
            run.y,
            tracking_error(run.y, reference.yd, peak_to_peak_um),
            tracking_error(run.reading, reference.yd, peak_to_peak_um),
            int(np.count_nonzero((run.u <= plant.min_voltage_v) | (run.u >= plant.max_voltage_v))),
        )
    return Panel(
        np.arange(len(reference.yd)) / plant.sample_rate_hz,
        reference.yd,
        peak_to_peak_um,
        loading_samples(reference.yd) / plant.sample_rate_hz,
        tracked,
    )


@cache
def _reference(trajectory: str, fs_hz: float) -> Trajectory:
    return load_trajectory(trajectory, fs_hz=fs_hz)
