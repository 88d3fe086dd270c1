"""Section II of Qin et al. (2013): the operators and the plant of Fig. 7 and 8, without a stage."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from torchpi.paper import fig3, fig4, fig5, fig7_plant, fig8
from torchpi.paper.context import Context
from torchpi.paper.result import Result, Row


@dataclass(frozen=True)
class Fig3Result(Result):
    """Plays with negative weights, individually and summed."""

    x: np.ndarray  # (time,)
    parts: np.ndarray  # (plays, time), weighted
    total: np.ndarray  # (time,)
    round_trip: float

    def numbers(self) -> dict[str, Any]:
        return {"fig3": {"round_trip": self.round_trip}}

    def rows(self) -> list[Row]:
        return [
            Row(
                "round trip with its forward operator, largest error",
                self.round_trip,
                paper=0.0,
                at_most=1e-12,
                note="r = [0 1 2 3 4], all weights 0.1; exact but for rounding",
            )
        ]


def compute_fig3(context: Context) -> Fig3Result:
    phase = 2 * torch.pi * torch.arange(1201, dtype=torch.float64)[None] / 400
    x = 2 * torch.sin(phase)
    operator = fig3.inverse()
    with torch.no_grad():
        h = operator.plays(x)[0][0]
        parts = (h * operator.w).T
    last = slice(-401, None)
    return Fig3Result(
        x[0, last].numpy(), parts[:, last].numpy(), parts.sum(0)[last].numpy(), fig3.round_trip()
    )


@dataclass(frozen=True)
class Fig4Result(Result):
    """A cubic compared with six dead zones."""

    curves: fig4.Fig4

    def numbers(self) -> dict[str, Any]:
        of = self.curves
        return {
            "more": {"fig4": {"max_percent": of.max_percent, "slope_jump_percent": of.slope_jump_percent}}
        }

    def rows(self) -> list[Row]:
        of = self.curves
        return [
            Row("numbers of the polynomial", of.cubic_numbers, paper=3),
            Row("numbers of the dead zones", of.dead_zone_numbers, paper=11),
            Row("distance of the two curves, largest", of.max_percent, "% of the output's range"),
            Row("jump of the slope at a threshold, largest", of.slope_jump_percent, "% of the mean slope"),
        ]


@dataclass(frozen=True)
class Fig5Result(Result):
    """Effect of the polynomial on the loop of an inverse."""

    x: np.ndarray  # (time,)
    u: np.ndarray  # (time,), with the polynomial
    u_plain: np.ndarray  # (time,), without
    end_slope_ratio: float

    def numbers(self) -> dict[str, Any]:
        return {"more": {"fig5": {"end_slope_ratio": self.end_slope_ratio}}}

    def rows(self) -> list[Row]:
        return [
            Row(
                "slope at the loop's end over that of its middle",
                self.end_slope_ratio,
                note="the paper shows near-vertical ends and gives no number",
            )
        ]


def compute_fig5(context: Context) -> Fig5Result:
    x, u = fig5.loop()
    return Fig5Result(x, u, fig5.loop(with_polynomial=False)[1], fig5.end_slope_ratio())


@dataclass(frozen=True)
class LoopOfFig7:
    """The loop at one frequency."""

    u: np.ndarray  # (time,), V
    y: np.ndarray  # (time,), µm
    area: float  # V µm


FIG7_AREAS = {
    "1": 10.3,
    "5": 11.0,
    "10": 11.9,
    "50": 18.8,
    "100": 27.4,
}  # recomputed from the paper's numbers


@dataclass(frozen=True)
class Fig7Result(Result):
    """Loops of the plant, which grow with the frequency."""

    loops: dict[str, LoopOfFig7]

    def numbers(self) -> dict[str, Any]:
        return {"fig7": {"area": {hz: loop.area for hz, loop in self.loops.items()}}}

    def rows(self) -> list[Row]:
        return [
            Row(f"area of the loop at {hz} Hz", loop.area, "V µm", FIG7_AREAS.get(hz), within_percent=1)
            for hz, loop in self.loops.items()
        ]


def compute_fig7(context: Context) -> Fig7Result:
    return Fig7Result(
        {
            str(hz): LoopOfFig7(*fig7_plant.loop(hz, 2_000), fig7_plant.loop_area(hz))
            for hz in fig7_plant.FREQUENCIES_HZ
        }
    )


INDIRECT_PERCENT = {"5": 0.26, "10": 0.56, "50": 4.2, "100": 11.6}  # recomputed from the paper's numbers
DIRECT_AT_MOST_PERCENT = {"5": 0.3, "10": 0.3, "50": 0.5, "100": 1.0}


@dataclass(frozen=True)
class Fig8Result(Result):
    """The plant of Fig. 7 driven by the indirect inverse, and by one direct compensator."""

    indirect: dict[str, fig8.Fig8]
    direct: dict[str, fig8.Fig8]
    preview: int
    seconds: float  # taken to learn the direct compensator

    def numbers(self) -> dict[str, Any]:
        return {
            "fig8": {
                f"{way}_max_percent": {hz: panel.max_percent for hz, panel in panels.items()}
                for way, panels in (("indirect", self.indirect), ("direct", self.direct))
            }
        }

    def rows(self) -> list[Row]:
        unit = "% of 9 µm"
        return [
            Row(
                f"indirect, {hz} Hz, max",
                panel.max_percent,
                unit,
                INDIRECT_PERCENT[hz],
                within_percent=10,
                note=f"rms {panel.rms_percent:.2g} %, start {panel.start_max_percent:.2g} %",
            )
            for hz, panel in self.indirect.items()
        ] + [
            Row(
                f"torchpi, direct, {hz} Hz, max",
                panel.max_percent,
                unit,
                INDIRECT_PERCENT[hz],
                at_most=DIRECT_AT_MOST_PERCENT[hz],
                note=f"rms {panel.rms_percent:.2g} %, start {panel.start_max_percent:.2g} %; "
                "the paper's number is that of the indirect approach",
            )
            for hz, panel in self.direct.items()
        ]


def compute_fig8(context: Context) -> Fig8Result:
    start = time.perf_counter()
    compensator = context.recipe.fig7().stream()
    seconds = time.perf_counter() - start
    return Fig8Result(
        {str(hz): fig8.indirect(hz) for hz in fig8.FREQUENCIES_HZ},
        {str(hz): fig8.deployed(compensator, hz) for hz in fig8.FREQUENCIES_HZ},
        int(compensator.preview),
        seconds,
    )
