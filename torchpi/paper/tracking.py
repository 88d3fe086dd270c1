"""Recording a plant, driving it along motions, and computing errors, in the same way for all experiments."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from torchpi.loop.result import loading_samples
from torchpi.operators.motion import Motion, backward_motion
from torchpi.recordings.recording import Recording

TRAVEL_UM = 8.1  # of the paper's stage


class Plant(Protocol):
    """A stage, or the plant of Fig. 7."""

    sample_rate_hz: float
    sample_period_s: float
    seed: int

    @property
    def min_voltage_v(self) -> float: ...
    @property
    def max_voltage_v(self) -> float: ...
    def simulate(self, u: Tensor, seed: int | None = None, /) -> tuple[Tensor, Tensor]: ...


class Deployed(Protocol):
    """An exported compensator: one voltage per sample; `block` takes many samples."""

    sample_period_s: float
    preview: int

    def reset(self) -> None: ...
    def block(self, yd: Tensor, /) -> Tensor: ...


class Compensator(Protocol):
    """A compensator that is trained or fitted, before it is exported."""

    sample_period_s: float
    preview: int

    def __call__(self, motion: Motion, /) -> Tensor: ...


@dataclass(frozen=True)
class Followed:
    """Signals of one motion of the plant."""

    u: np.ndarray  # (time,), V
    y: np.ndarray  # (time,), µm, true displacement
    reading: np.ndarray  # (time,), µm, of the sensor


@dataclass(frozen=True)
class TrackingError:
    """Error over the whole motion and after the initial loading; % of the reference's peak to peak."""

    max_um: float
    rms_um: float
    max_percent: float
    rms_percent: float
    max_percent_of_travel: float  # % of the 8.1 µm
    max_um_after_loading: float
    rms_um_after_loading: float
    max_percent_after_loading: float
    extreme_um: float  # the largest error with its sign
    mean_um_after_loading: float  # shows a drift, if there is one


def record(
    plant: Plant,
    name: str,
    samples: tuple[np.ndarray, np.ndarray],  # t (time,), s; u (time,), V
    seed: int,
) -> Recording:
    """Record the sensor reading while the plant is driven with `samples`."""
    t, u = samples
    with torch.no_grad():
        _, y = plant.simulate(torch.from_numpy(u)[None], seed)
    return Recording(name, t, u, y[0].numpy(), plant.sample_rate_hz)


def follow(
    compensator: Deployed,
    plant: Plant,
    yd: np.ndarray,  # (time,), µm
    beyond: np.ndarray | None = None,  # continuation of the motion, for compensators that look ahead
) -> Followed:
    """Drive the plant along `yd` from the de-energised state; without `beyond`, the motion ends at rest."""
    beyond = np.full(compensator.preview, yd[-1]) if beyond is None else beyond
    ahead = np.concatenate([yd, beyond])[compensator.preview :][: len(yd)]
    with torch.no_grad():
        compensator.reset()
        u = compensator.block(torch.from_numpy(ahead))
        y, reading = plant.simulate(u[None], plant.seed)
    return Followed(u.numpy(), y[0].numpy(), reading[0].numpy())


def tracking_error(
    y: np.ndarray,  # (time,), µm
    yd: np.ndarray,  # (time,), µm
    peak_to_peak_um: float,  # of the reference y_r, so that the rise of y_d from rest does not count
) -> TrackingError:
    """Return the error y − y_d in all its measures."""
    error = y - yd
    after = error[loading_samples(yd) :]
    max_um, max_after_um = float(np.abs(error).max()), float(np.abs(after).max())
    return TrackingError(
        max_um=max_um,
        rms_um=_rms(error),
        max_percent=100 * max_um / peak_to_peak_um,
        rms_percent=100 * _rms(error) / peak_to_peak_um,
        max_percent_of_travel=100 * max_um / TRAVEL_UM,
        max_um_after_loading=max_after_um,
        rms_um_after_loading=_rms(after),
        max_percent_after_loading=100 * max_after_um / peak_to_peak_um,
        extreme_um=float(error[np.abs(error).argmax()]),
        mean_um_after_loading=float(after.mean()),
    )


class InOnePass:
    """A compensator run over a whole motion at once: the same bits as its stream, a hundred times as fast."""

    def __init__(self, compensator: Compensator) -> None:
        self.compensator = compensator
        self.sample_period_s = compensator.sample_period_s
        self.preview = compensator.preview

    def reset(self) -> None:
        """Do nothing, because every motion starts de-energised."""

    def block(self, yd: Tensor) -> Tensor:
        return self.compensator(backward_motion(yd[None], self.sample_period_s))[0]


class StraightLine:
    """No compensation: u = y_d / gain within the limits, with the gain fitted to a recording through 0."""

    def __init__(self, slow: Recording, preview: int = 0, low_v: float = 0.0, high_v: float = 10.0) -> None:
        self.sample_period_s = 1 / slow.fs_hz
        self.preview = preview
        self.gain_um_per_v = float(slow.u @ slow.y / (slow.u @ slow.u))
        self.low_v, self.high_v = low_v, high_v

    def reset(self) -> None:
        """Do nothing, because there is no memory."""

    def block(self, yd: Tensor) -> Tensor:
        return (yd / self.gain_um_per_v).clamp(self.low_v, self.high_v)


def _rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error**2)))
