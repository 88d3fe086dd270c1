"""The task that every peer is given, and what a peer returns.

The task is a direct inverse: the motion of a simulated stage goes in, and the voltage that caused it comes
out. One record is fitted; others, with different motions in the same band, are held out.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from torchpi import Motion, Recording, Stage
from torchpi.excitation.signals import multisine
from torchpi.identification import InversePair, inverse_pair

STAGE = Path(__file__).parents[2] / "configs" / "stage" / "qin2013.yaml"
PREVIEW = 2  # samples: the stage responds about two samples late, so the motion two samples ahead is used
BANDWIDTH_HZ = 1000.0
EDGE = 100  # samples cut off, because the acceleration is inaccurate at the ends of a record

Signal = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Task:
    """Records, and the constants of the direct inverse that all peers with plays fit.

    Attributes:
        train: The record to fit.
        held_out: Held-out records for evaluation, each from the de-energised state.
        sample_period_s: T.
        thresholds_um: r of the plays, denser near 0, where reversals are.
        creep_time_constants_s: T_j of the relaxations.
        degree: m of the polynomial.
        high_v: Upper end of the voltage range, which begins at 0.
        scales: Largest displacement (µm), rate (µm/s) and acceleration (µm/s²) of the record to fit.
    """

    train: InversePair
    held_out: tuple[InversePair, ...]
    sample_period_s: float
    thresholds_um: Signal
    creep_time_constants_s: tuple[float, ...]
    degree: int
    high_v: float
    scales: Signal

    def inputs(self, pair: InversePair) -> Signal:
        """Displacement, rate and acceleration, each divided by its entry of `scales`. Shape: (time, 3)."""
        return np.stack([part[0].numpy() for part in pair.motion], 1) / self.scales

    def clipped(self, voltage: Signal) -> Signal:
        return np.clip(voltage, 0.0, self.high_v)


@dataclass(frozen=True)
class Fitted:
    """What a peer returns.

    Attributes:
        voltage: Predicts a whole record from the de-energised state, (time,), V, before the output limits.
        fit_s: Processor time to fit, compilation included.
        compile_s: The part of it that was compilation, if the peer can tell.
        step: One sample: displacement, rate, acceleration (µm, µm/s, µm/s²) in, V out; None where the
            library has no way to run sample by sample.
    """

    voltage: Callable[[InversePair], Signal]
    fit_s: float
    compile_s: float | None = None
    step: Callable[[float, float, float], float] | None = None


@dataclass(frozen=True)
class Peer:
    """A way to do the task.

    Attributes:
        name: Name in the table.
        package: Package that must be importable.
        settings: What was fitted and how, for the page.
        purpose: What it is made for, for the page.
        fit: Performs the task.
        repeats: How many times it is fitted.
        compiles: Whether its first fit compiles what the later ones reuse.
    """

    name: str
    package: str
    settings: str
    purpose: str
    fit: Callable[[Task], Fitted]
    repeats: int = 1
    compiles: bool = False


def make_task(samples: int = 12_000, held_out: int = 3, plays: int = 10) -> Task:
    """Random-phase multisines, 1 to 100 Hz over 0 to 10 V, on a stage as hard as the paper's rig."""
    stage = Stage.from_yaml(STAGE)
    train, *others = (_record(stage, samples, seed) for seed in range(1, held_out + 2))
    scales = np.array([float(part.abs().max()) for part in train.motion])
    return Task(
        train,
        tuple(others),
        stage.sample_period_s,
        0.6 * scales[0] * (np.arange(plays) / (plays - 1)) ** 2,
        (0.01, 0.1, 1.0),
        4,
        stage.max_voltage_v,
        scales,
    )


def _record(stage: Stage, samples: int, seed: int) -> InversePair:
    fs_hz, ramp_in_s = stage.sample_rate_hz, 0.02
    duration_s = (samples + EDGE + PREVIEW) / fs_hz - ramp_in_s
    t, u = multisine(duration_s, fs_hz, high_hz=100, periods=1, seed=seed, ramp_in_s=ramp_in_s)
    with torch.no_grad():
        _, y = stage.simulate(torch.from_numpy(u)[None], seed)
    pair = inverse_pair(Recording(f"multisine {seed}", t, u, y[0].numpy(), fs_hz), PREVIEW, BANDWIDTH_HZ)
    motion = Motion(*(part[:, :samples].contiguous() for part in pair.motion))
    return pair._replace(motion=motion, u=pair.u[:, :samples], counted=slice(0, samples))
