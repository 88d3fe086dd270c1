"""Accuracy of an inverse on records: its voltage error, also expressed in µm and per cent."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import torch
from torch import Tensor

from torchpi.control.direct_inverse import DirectInverse
from torchpi.identification.pair import InversePair


@dataclass(frozen=True)
class InverseErrors:
    """Errors of the predicted voltage over the counted samples of some records.

    `_um` is the voltage error times the local slope of the measured loop: the displacement by which the stage
    would miss. `_percent` is `rms_um` and `max_um` as a percentage of the records' peak to peak.
    """

    rms_v: float
    max_v: float
    rms_um: float
    max_um: float
    rms_percent: float
    max_percent: float

    def as_dict(self) -> dict[str, float]:
        return asdict(self)


def inverse_errors(
    compensator: DirectInverse,
    pairs: Sequence[InversePair],
    loading_excluded: bool = False,
    zeros_um: Sequence[float] | None = None,
) -> InverseErrors:
    """Return the errors of `compensator` over the records, each started from the de-energised state.

    Args:
        compensator: The inverse to judge; its output limits apply.
        pairs: Records, made with the compensator's preview.
        loading_excluded: Whether to leave out the samples before a record first reaches its largest
            displacement: until then the loop depends on its initial state.
        zeros_um: Sensor zero of each record, subtracted from its displacement.
    """
    volts, microns, span = [], [], 0.0
    for pair, zero_um in zip(pairs, zeros_um or [0.0] * len(pairs), strict=True):
        motion = pair.motion._replace(yd=pair.motion.yd - zero_um)
        with torch.no_grad():
            error = compensator(motion) - pair.u
        counted = pair.counted
        if loading_excluded:
            counted = slice(max(counted.start, loading_end(motion.yd[0])), counted.stop)
        slope = local_slope(motion.yd[0], pair.u[0])
        volts.append(error[0, counted])
        microns.append((error[0] * slope)[counted])
        span = max(span, float(motion.yd[0, pair.counted].max() - motion.yd[0, pair.counted].min()))
    rms_v, max_v = _rms_and_max(torch.cat(volts))
    rms_um, max_um = _rms_and_max(torch.cat(microns))
    return InverseErrors(rms_v, max_v, rms_um, max_um, 100 * rms_um / span, 100 * max_um / span)


def loading_end(y: Tensor) -> int:
    """Return the first sample within 2 % of the record's largest displacement; shape of y: (time,).

    The tolerance allows for creep, which carries later peaks of the same voltage a little further.
    """
    threshold = y.max() - 0.02 * (y.max() - y.min())
    return int(torch.nonzero(y >= threshold)[0])


def local_slope(
    y: Tensor,  # (time,), µm
    u: Tensor,  # (time,), V
) -> Tensor:  # (time,), µm/V
    """Return the slope of the measured loop around each sample.

    The steps of y are regressed on the steps of u, over as many samples as u takes to move by a twentieth of
    its range. Where u rests, the slope of the whole loop is used. Near a reversal, where a lag can flip the
    sign, the slope is at least a quarter of that of the whole loop.

    Example:
        >>> import torch
        >>> from torchpi.identification import local_slope
        >>> u = torch.linspace(0.0, 10.0, 200, dtype=torch.float64)
        >>> round(local_slope(0.8 * u, u)[100].item(), 3)
        0.8
    """
    whole = (y.max() - y.min()) / (u.max() - u.min())
    dy, du = y.diff(prepend=y[:1]), u.diff(prepend=u[:1])
    steps = du.abs()
    moving = steps[steps > 1e-3 * steps.max()].median()
    width = max(3, min(len(u) // 4, int(0.05 * (u.max() - u.min()) / moving))) | 1
    rest = 1e-2 * width * moving**2
    slope = (_window_sum(dy * du, width) + rest * whole) / (_window_sum(du * du, width) + rest)
    return slope.clamp(0.25 * whole, 4.0 * whole)


def _window_sum(values: Tensor, width: int) -> Tensor:
    padded = torch.nn.functional.pad(values.cumsum(0), (1, 0))
    index = torch.arange(len(values))
    return padded[(index + width // 2 + 1).clamp(max=len(values))] - padded[(index - width // 2).clamp(min=0)]


def _rms_and_max(error: Tensor) -> tuple[float, float]:
    return float(error.square().mean().sqrt()), float(error.abs().max())
