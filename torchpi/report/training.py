"""The content of the training page: plain numbers and arrays, computed by the training code."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Signal = npt.NDArray[np.float64]


@dataclass(frozen=True)
class RecordFit:
    """One recording, and the voltage that the compensator predicts for its motion."""

    name: str
    role: str  # 'trained on' or 'held out'
    t: Signal  # (time,), s
    y: Signal  # (time,), µm
    u: Signal  # (time,), V, recorded
    u_hat: Signal  # (time,), V, predicted


@dataclass(frozen=True)
class WeightsAgainstRate:
    """Weights w_i(ẏ) of every play, eq. 7, over the rates that occur."""

    rate: Signal  # (rates,), µm/s, rising
    w: Signal  # (rates, plays), V per unit of the play's input
    r: Signal  # (plays,), thresholds


@dataclass(frozen=True)
class Saturation:
    """The polynomial S of eq. 4 over the displacements that occur."""

    y: Signal  # (points,), µm, rising
    s: Signal  # (points,)
    c: Signal  # (degree,), c_1 first


@dataclass(frozen=True)
class TrainingReport:
    """A training run on recordings.

    Args:
        name: name of the run.
        metrics: `metrics.json`: 'train', 'heldout', 'baseline_lstsq', 'loading_excluded', each with rms_v,
            max_v, rms_um, max_um, rms_percent, max_percent. Further keys of the same form are shown too.
        records: recordings to draw, the held-out ones first.
        weights: weights against rate; None if they do not depend on the rate.
        saturation: the polynomial.
        notes: sentences for the reader.
    """

    name: str
    metrics: Mapping[str, Mapping[str, float]]
    records: tuple[RecordFit, ...]
    weights: WeightsAgainstRate | None = None
    saturation: Saturation | None = None
    notes: tuple[str, ...] = field(default=())
