"""A recording as the direct inverse sees it: displacement in, voltage out."""

from typing import NamedTuple

import torch
from torch import Tensor

from torchpi.errors import RecordingError
from torchpi.operators.motion import Motion
from torchpi.recordings.differentiation import motion_bandwidth, zero_phase_motion
from torchpi.recordings.recording import Recording


class InversePair(NamedTuple):
    """One record on which an inverse is fitted or judged.

    Attributes:
        name: Name of the recording.
        motion: Smoothed displacement, its rate and acceleration, (1, time); its sample t lies `preview`
            periods ahead of sample t of the voltage.
        u: Voltage, (1, time), V.
        counted: Slice of the samples that count in a loss or an error; the others only set the state.
        sample_period_s: T.
        weight: Weight of its squared errors in a fit.
    """

    name: str
    motion: Motion
    u: Tensor
    counted: slice
    sample_period_s: float
    weight: float = 1.0

    @property
    def rate_um_s(self) -> float:
        """Rms of ẏ, µm/s."""
        return float(self.motion.yd_dot[0, self.counted].square().mean().sqrt())


def inverse_pair(
    recording: Recording,
    preview: int = 0,
    bandwidth_hz: float | None = None,
    skip_s: float = 0.0,
) -> InversePair:
    """Swap input and output of a recording: its displacement, `preview` samples ahead, becomes the input.

    Args:
        recording: Voltage and displacement.
        preview: Samples of look-ahead.
        bandwidth_hz: Bandwidth of the zero-phase differentiator; chosen from the record if None.
        skip_s: Start-up transient, which sets the state but is not counted.

    Raises:
        RecordingError: Fewer than 100 samples are left to count.

    Example:
        >>> import numpy as np
        >>> from torchpi import Recording
        >>> from torchpi.identification import inverse_pair
        >>> t = np.arange(4000) / 1e4
        >>> u = 5 - 5 * np.cos(2 * np.pi * 5 * t)
        >>> pair = inverse_pair(Recording.from_arrays(t, u, 0.8 * u), preview=2)
        >>> (tuple(pair.u.shape), round(pair.rate_um_s))
        ((1, 3998), 89)
    """
    bandwidth = bandwidth_hz or motion_bandwidth(recording.y, recording.fs_hz)
    motion = Motion(
        *(
            torch.tensor(part, dtype=torch.float64)[None]
            for part in zero_phase_motion(recording.y, recording.fs_hz, bandwidth)
        )
    )
    u = torch.tensor(recording.u, dtype=torch.float64)[None]
    start = round(skip_s * recording.fs_hz)
    whole = InversePair(recording.name, motion, u, slice(start, u.shape[1]), 1.0 / recording.fs_hz)
    return seen_ahead(whole, preview, recording.source)


def seen_ahead(pair: InversePair, preview: int, source: str = "") -> InversePair:
    """Return the record with `preview` more samples of look-ahead, which are cut off its end.

    Args:
        pair: A whole record.
        preview: Samples.
        source: Path of the file, for the error message.

    Raises:
        RecordingError: Fewer than 100 samples are left to count.
    """
    samples, start = pair.u.shape[1] - preview, pair.counted.start
    if samples - start < 100:
        raise RecordingError(
            f"{source or pair.name}: found {pair.u.shape[1]} samples, expected at least 100 "
            f"beyond the {preview} of preview and the {start} of skip_s"
        )
    motion = Motion(*(part[:, preview:] for part in pair.motion))
    return pair._replace(motion=motion, u=pair.u[:, :samples], counted=slice(start, samples))
