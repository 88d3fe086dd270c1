"""What an inverse is worth on a record: its voltage error, and the same in µm and per cent."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import torch
from torch import Tensor

from torchpi.control.direct_inverse import DirectInverse
from torchpi.identification.pair import InversePair


@dataclass(frozen=True)
class InverseErrors:
    """Errors of the predicted voltage over the counted samples of some records.

    `_um` is the voltage error through the local slope of the measured loop: the displacement by which
    the stage would miss. Per cent is `rms_um` and `max_um` of the records' peak to peak.
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
    """Errors of `compensator` over the records, each from the de-energised state.

    Args:
        compensator: What is judged; its output limits apply.
        pairs: Records, made with the compensator's preview.
        loading_excluded: Whether to leave out what comes before a record first reaches its largest
            displacement: until then the loop remembers how it was started.
        zeros_um: Zero of the sensor of each record, taken off its displacement.
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
    """First sample within 2 % of the record's largest displacement; shape (time,).

    Wide enough for creep, which carries later peaks of the same voltage a little further.
    """
    threshold = y.max() - 0.02 * (y.max() - y.min())
    return int(torch.nonzero(y >= threshold)[0])


def local_slope(
    y: Tensor,  # (time,), µm
    u: Tensor,  # (time,), V
) -> Tensor:  # (time,), µm/V
    """Slope of the measured loop about each sample.

    Least squares of the steps of y on the steps of u, over as many samples as u takes to move by a
    twentieth of its range. Where u rests the slope of the whole loop stands in; about a reversal,
    where a lag turns the sign, a quarter of it is the least.

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
