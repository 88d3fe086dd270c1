"""Simulations that share no code with torchpi: static plays of their own, a mode from python-control.

A diagnosis calls them some hundred times, so their loops over samples are compiled.
"""

import control
import numba
import numpy as np
import torch
from scipy.signal import lfilter

from tests.diagnosis.plants import multisine, triangles
from torchpi.recordings.recording import Recording
from torchpi.stage import Stage

FS_HZ, NOISE_UM = 2_000.0, 0.004
THRESHOLDS_V, WEIGHTS = (0.0, 0.3, 0.8, 1.7, 3.0, 5.0), (0.5, 0.05, 0.06, 0.07, 0.08, 0.04)
OTHER_WEIGHTS = (0.55, 0.1, 0.0, 0.1, 0.02, 0.04)
CREEP = {"creep_per_decade": 0.02, "creep_from_s": 1e-3 * 10**0.5, "creep_to_s": 100}


def plays(u_v: np.ndarray, fs_hz: float, weights: tuple[float, ...] = WEIGHTS) -> np.ndarray:
    """Simulate static hysteresis and nothing else."""
    return weighted(u_v, np.array(THRESHOLDS_V), np.array(weights))


@numba.njit
def weighted(u_v: np.ndarray, r: np.ndarray, weights: np.ndarray) -> np.ndarray:
    y, h = np.empty(len(u_v)), np.zeros(len(r))
    for k in range(len(u_v)):
        h = np.maximum(u_v[k] - r, np.minimum(u_v[k] + r, h))
        y[k] = np.sum(h * weights)
    return y


def with_mode(x: np.ndarray, fs_hz: float, frequency_hz: float, damping_ratio: float = 0.03) -> np.ndarray:
    """Pass a displacement through a mode of unit static gain."""
    w = 2 * np.pi * frequency_hz
    mode = control.tf([w * w], [1, 2 * damping_ratio * w, w * w])
    sampled = control.sample_system(mode, 1 / fs_hz, "foh")
    return lfilter(sampled.num[0][0], sampled.den[0][0], x)


def right(u_v: np.ndarray, fs_hz: float) -> np.ndarray:
    """Simulate the hysteresis and the mode of `stage`."""
    return with_mode(plays(u_v, fs_hz), fs_hz, 300.0)


def wrong_mode(u_v: np.ndarray, fs_hz: float) -> np.ndarray:
    """Simulate a mode with another frequency and damping than that of `stage`."""
    return with_mode(plays(u_v, fs_hz), fs_hz, 270.0, 0.05)


def wrong_hysteresis(u_v: np.ndarray, fs_hz: float) -> np.ndarray:
    """Simulate plays with other weights than those of `stage`."""
    return plays(u_v, fs_hz, OTHER_WEIGHTS)


def stage(creep: bool = False, cutoff_hz: float | None = None, mode: bool = True) -> Stage:
    """Return the stage that is recorded."""
    hysteresis = {"thresholds_v": list(THRESHOLDS_V), "weights_um_per_v": list(WEIGHTS)}
    settings = {
        "sample_rate_hz": FS_HZ,
        "amplifier": {} if cutoff_hz is None else {"cutoff_hz": cutoff_hz},
        "actuator": {**hysteresis, **(CREEP if creep else {})},
        "mechanics": {"frequency_hz": 300.0, "damping_ratio": 0.03} if mode else {},
        "sensor": {"noise_um": NOISE_UM},
    }
    return Stage.from_dict(settings)


def recorded(stage: Stage, samples: int = 2000) -> list[Recording]:
    """Record a multisine and triangles on a stage."""
    found = []
    for seed, u in enumerate((multisine(samples, FS_HZ), triangles(samples, fs_hz=FS_HZ))):
        y = stage.simulate(torch.from_numpy(u)[None], seed)[1][0].detach().numpy()
        found.append(Recording(("multisine", "triangles")[seed], np.arange(len(u)) / FS_HZ, u, y, FS_HZ))
    return found
