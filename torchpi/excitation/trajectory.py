"""Trajectories to follow: the paper's, passed through its reference filter, or one from a file."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from torchpi.errors import RecordingError
from torchpi.excitation.signals import fast_trajectory, slow_trajectory
from torchpi.operators.reference_filter import ReferenceFilter
from torchpi.recordings.signal import read_signal

Signal = npt.NDArray[np.float64]  # shape: (time,)


@dataclass(frozen=True)
class Trajectory:
    """A reference trajectory: y_d, and y_r before the reference filter."""

    name: str
    title: str
    fs_hz: float
    yd: Signal  # (time,), µm
    yr: Signal  # (time,), µm
    sha256: str | None  # hash of the file, None if it did not come from one


def load_trajectory(
    which: str | Path,
    *,
    fs_hz: float,
    resample: bool = False,
    through_reference_filter: bool = False,
) -> Trajectory:
    """Return the paper's slow or fast trajectory, or one from a file.

    The paper's trajectories are eq. 15 for 2 s and eq. 16 for 1 s, passed through the reference filter
    (eq. 14) from rest. A file holds the columns `time_s` and `yd_um` (or `output_um`, so that the motion of a
    recording can be followed), sampled uniformly.

    Args:
        which: 'slow', 'fast', or the path of a file.
        fs_hz: sample rate of the result.
        resample: resample a file of another sample rate, or of uneven sampling, to `fs_hz`.
        through_reference_filter: take a file's motion as y_r and filter it, for a compensator that contains
            the reference filter.

    Raises:
        RecordingError: if the file is missing, or a column, a row or the sampling is not as expected.

    Example:
        >>> from torchpi.excitation import load_trajectory
        >>> fast = load_trajectory("fast", fs_hz=10_000.0)
        >>> f"{fast.title}: {len(fast.yd)} samples, {fast.yd.min():.2f} to {fast.yd.max():.2f} µm"
        'eq. 16 (fast): 10000 samples, 0.00 to 7.83 µm'
    """
    if which in _PAPER:
        make, title, duration_s = _PAPER[str(which)]
        _, yr = make(duration_s, fs_hz)
        return Trajectory(str(which), title, fs_hz, _filtered(yr, fs_hz), yr, None)
    path = Path(which)
    if not path.is_file():
        raise RecordingError(f"{path}: no such file; expected 'slow', 'fast', or a CSV file of time_s,yd_um")
    y, sha256 = _read_motion(path, fs_hz, resample)
    yd = _filtered(y, fs_hz) if through_reference_filter else y
    return Trajectory(path.stem, path.name, fs_hz, yd, y, sha256)


_PAPER = {"slow": (slow_trajectory, "eq. 15 (slow)", 2.0), "fast": (fast_trajectory, "eq. 16 (fast)", 1.0)}


def _read_motion(path: Path, fs_hz: float, resample: bool) -> tuple[Signal, str]:
    """Return the file's motion at `fs_hz`, µm, and its hash."""
    try:
        motion = read_signal(path, "yd_um", resample=resample, min_samples=10)
    except RecordingError as error:
        try:
            motion = read_signal(path, "output_um", resample=resample, min_samples=10)
        except RecordingError:
            raise error from None
    if np.isclose(motion.fs_hz, fs_hz, rtol=1e-4):
        return motion.x, motion.sha256
    if not resample:
        raise RecordingError(
            f"{path}: sampled at {motion.fs_hz:.6g} Hz; expected {fs_hz:.6g} Hz, the compensator's rate: "
            "--resample true interpolates"
        )
    # Monotone interpolation, so that the resampled motion never goes beyond the given one.
    from scipy.interpolate import PchipInterpolator

    t = np.arange(len(motion.x)) / motion.fs_hz
    grid_s = np.arange(int(t[-1] * fs_hz + 1e-6) + 1) / fs_hz
    return PchipInterpolator(t, motion.x)(np.minimum(grid_s, t[-1])), motion.sha256


def _filtered(yr: Signal, fs_hz: float) -> Signal:
    return ReferenceFilter(1.0 / fs_hz)(torch.from_numpy(yr)[None]).yd[0].numpy()
