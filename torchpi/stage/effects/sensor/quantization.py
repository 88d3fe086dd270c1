"""Readings on a lattice: y = o + q round((x - o) / q) (Widrow and Kollár, *Quantization Noise*, 2008)."""

import math
from typing import NamedTuple, cast

import numpy as np
from torch import Tensor, nn

from torchpi.operators.base import Static, StepStream
from torchpi.operators.chain import ChainStream
from torchpi.operators.quantization import Quantize, quantize_step
from torchpi.stage.effects.effect import DataRange, Effect, Parameters, parameter

FEWEST_READINGS = 8  # distinct readings; fewer lie on some lattice by chance
FEWEST_RECURRING = 4  # distinct readings, if evenly spaced and each read at several commands
FARTHEST = 0.2  # largest distance from a reading to its place, in steps; by chance, 2 in 5 lie within
FLOAT32_STEP = 2.0**-23
EVEN = 0.01  # largest distance of a gap from a whole multiple of the smallest, for evenly spaced values
NARROWEST = 0.25  # width of a code over the typical one; without codes the narrowest gap is tiny
RECURRING = 0.2  # share of the values that recur at another command; noise or motion hardly repeats any
ONE_CODE = 1.75  # largest gap, in steps, between neighbouring codes; a wider one passes a code unseen
ANOTHER = 1e-6  # smallest difference between two commands, over their span, that is not one of rounding


class Quantization(Static, Effect):
    """A converter of finite resolution and no end of range; `lsb_um` 0 has no steps.

    Straight-through: the gradient in x is 1, as if there were no steps, and that in the two parameters is 0.
    `lattice` determines the step from the recorded readings, because gradient descent cannot find it.
    """

    name = "quantization"
    block = "sensor"
    equation = "y = o + q round((x - o) / q)"
    signature = "readings on a grid of levels; an error uniformly distributed over one step"
    time_scale = "static"
    read_off = True
    lsb_um: nn.Parameter = parameter("µm", at_least=0, at_most=100)
    offset_um: nn.Parameter = parameter("µm", at_least=-1e6, at_most=1e6)

    def of(self, x: Tensor) -> Tensor:
        if self.lsb_um.item() == 0.0:
            return x
        return cast(Tensor, Quantize.apply(x, self.offset_um, self.lsb_um, -math.inf, math.inf))

    def stream(self) -> nn.Module:
        if self.lsb_um.item() == 0.0:
            return ChainStream([])
        return StepStream(quantize_step, [self.offset_um.item(), self.lsb_um.item(), -math.inf, math.inf])

    def tangent(self, x: Tensor, dx: Tensor) -> Tensor:
        return dx

    @classmethod
    def starts(cls, seen: DataRange) -> list[Parameters]:
        return []

    @classmethod
    def lattice(
        cls,
        readings: np.ndarray,  # (time,), µm
        commands: np.ndarray | None = None,  # (time,), V
    ) -> float | None:
        """Return the step, µm, of the lattice that all recorded readings lie on; None if there is none.

        The step may be smaller than the noise, and the readings may have been rounded to float32 or to
        decimals of a tenth of a step. None also if fewer than 8 readings differ, unless each of 4 or more
        recurs at another command, or if the lattice is only that of the file: steps of 10^-k with k ≥ 5, or
        so fine that float32 hardly resolves them.
        """
        y = np.unique(np.asarray(readings, dtype=np.float64))
        finest = 4 * FLOAT32_STEP * np.abs(y).max(initial=0.0)
        gaps = np.diff(y)
        gaps = gaps[gaps > 1e-9 * (y[-1] - y[0])] if len(y) else gaps
        farthest = FARTHEST
        if len(gaps) + 1 < FEWEST_READINGS:
            if commands is None or len(y) < FEWEST_RECURRING or _recurring(readings, commands) < len(y):
                return None
            farthest = EVEN
        # Two readings one step apart are likely, but not certain: the smallest gap may be several steps.
        for steps_in_smallest in range(1, 9):
            step = _refined(gaps, gaps.min() / steps_in_smallest)
            if step < finest:
                return None
            if _misfit(y, step) < farthest:
                return None if _is_decimal(step) else step
        return None


def half_width_um(
    readings: np.ndarray,  # (time,), µm
    step_um: float,
) -> float:
    """Return half the width of the 90 % interval of the step of a lattice, µm, from the scatter of the
    readings about their places: a file with few decimals rounds them."""
    y = np.unique(np.asarray(readings, dtype=np.float64))
    codes = np.round((y - _offset(y, step_um)) / step_um)
    codes -= codes.mean()
    left = y - y.mean() - step_um * codes
    freedom = len(y) - 2
    return _quantile(freedom) * math.sqrt(left @ left / freedom / (codes @ codes))


class Codes(NamedTuple):
    """The spacing of the values on which readings lie."""

    step_um: float
    """Mean width of a code."""
    half_width_um: float
    """Half the width of the 90 % interval of the step."""


def uneven_codes(
    readings: np.ndarray,  # (time,), µm
    commands: np.ndarray,  # (time,), V
) -> Codes | None:
    """Return the typical step of readings that lie on unevenly spaced values; None if they do not.

    A converter's code widths differ (differential nonlinearity: IEEE Std 1241-2010, 9.2). Its values recur at
    other commands, which distinguishes it from a stage without noise that is sent to the same places again.
    How many codes no reading has, with its variance, is estimated from those with one and with two (Chao,
    *Scandinavian Journal of Statistics* 11, 1984; *Biometrics* 43, 1987). The scatter of the widths between
    neighbouring codes adds to the uncertainty of the step: it is that of the codes which were not passed.
    """
    y, counts = np.unique(readings, return_counts=True)
    least = RECURRING * len(y)
    # Where hardly any reading is repeated, as without a converter, there is no need to look at the commands.
    if len(y) < FEWEST_READINGS or len(readings) - len(y) < least or _recurring(readings, commands) < least:
        return None
    once, twice = np.count_nonzero(counts == 1), np.count_nonzero(counts == 2) + 1
    unseen = once * (once - 1) / (2 * twice)
    codes = len(y) - 1 + unseen
    step = float((y[-1] - y[0]) / codes)
    gaps = np.diff(y)
    narrowest = gaps.min()
    multiples = gaps / narrowest
    # Evenly spaced values come from a file with few decimals, or from a lattice.
    uneven = (np.abs(multiples - np.round(multiples)) > EVEN).any()
    if not uneven or narrowest < NARROWEST * step:
        return None
    widths = gaps[gaps < ONE_CODE * step]
    widths = widths if len(widths) > 1 else gaps  # no two codes in a row were read
    variance = unseen + once * (2 * once - 1) ** 2 / (4 * twice**2)
    variance += once**2 * (twice - 1) * (once - 1) ** 2 / (4 * twice**4)
    scatter = float(widths.var(ddof=1)) / codes + step**2 * variance / codes**2
    return Codes(step, _quantile(len(widths) - 1) * math.sqrt(scatter))


def _quantile(freedom: int) -> float:
    """Return the quantile of Student's t that bounds 90 %, two-sided."""
    # Imported here, because the import takes half a second and a stage does not need it.
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.95))


def _recurring(readings: np.ndarray, commands: np.ndarray) -> int:
    """Count the values that readings have at two commands, apart from those that follow one another."""
    order = np.argsort(readings, kind="stable")
    y, u = readings[order], commands[order]
    again = (np.diff(y) == 0) & (np.diff(order) > 1) & (np.abs(np.diff(u)) > ANOTHER * np.ptp(commands))
    return len(np.unique(y[1:][again]))


def _refined(gaps: np.ndarray, step: float) -> float:
    """Refine a first guess of the step of which the gaps are whole multiples.

    A wide gap determines the step more precisely, but counting its steps takes a guess that is already
    precise, so the refinement proceeds from the narrow gaps to the wide ones.
    """
    reach = 1.5 * step
    while True:
        near = gaps[gaps <= max(reach, gaps.min())]
        counts = np.maximum(np.round(near / step), 1)
        step = float((near * counts).sum() / (counts * counts).sum())
        if reach >= gaps.max():
            break
        reach *= 2
    # Last, the places themselves: their whole span determines the step more precisely than any gap.
    codes, places = np.cumsum(np.round(gaps / step)), np.cumsum(gaps)
    codes, places = codes - codes.mean(), places - places.mean()
    return float((codes * places).sum() / (codes * codes).sum())


def _misfit(y: np.ndarray, step: float) -> float:
    """Return the largest distance of a reading from its place on the lattice, in steps."""
    from_place = (y - _offset(y, step)) / step
    return float(np.abs(from_place - np.round(from_place)).max())


def _offset(y: np.ndarray, step: float) -> float:
    """Return the circular mean of y modulo the step."""
    turn = np.exp(2j * math.pi * (y / step)).mean()
    return float(step * (np.angle(turn) / (2 * math.pi) % 1.0))


def _is_decimal(step: float) -> bool:
    """Whether the step is 10^-k with k ≥ 5, as in a text format."""
    decimals = -math.log10(step)
    return decimals > 4.5 and abs(decimals - round(decimals)) < 1e-4
