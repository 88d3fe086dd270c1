"""Section III and IV of Qin et al. (2013), on the simulated stage: identification, tracking, claims."""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch

from torchpi.control.direct_inverse import DirectInverse
from torchpi.paper import claims, fig12, fig13, methods, unseen
from torchpi.paper import fig10 as identification
from torchpi.paper.calibration import PAPER_MAX_UM, calibrate_paper_method, without
from torchpi.paper.context import Context
from torchpi.paper.fig8 import Fig8
from torchpi.paper.result import Result, Row
from torchpi.paper.tracking import Deployed, StraightLine, TrackingError


@dataclass(frozen=True)
class MethodsResult(Result):
    """Errors by method, in the order of `methods.LABELS`."""

    fig7: dict[str, dict[str, float]]  # % of 9 µm, by frequency
    stage: dict[str, dict[str, TrackingError]]  # by trajectory; without look-ahead, except torchpi
    ahead: dict[str, dict[str, TrackingError]]  # likewise, all with torchpi's look-ahead
    preview: int
    dilation: str

    def numbers(self) -> dict[str, Any]:
        table: dict[str, Any] = {name: {} for name in methods.LABELS}
        for name, by_hz in self.fig7.items():
            table[name]["fig7_max_percent"] = by_hz
        for key, by_method in (("stage", self.stage), ("stage_with_look_ahead", self.ahead)):
            for name, by_trajectory in by_method.items():
                table[name][key] = {
                    trajectory: {"max_percent": error.max_percent, "rms_percent": error.rms_percent}
                    for trajectory, error in by_trajectory.items()
                }
        return {"more": {"methods": table}}


def compute_methods(context: Context) -> MethodsResult:
    stage = context.stage
    preview = context.done["learning"].compensator().preview
    of_fig7 = {name: methods.on_fig7(one) for name, one in methods.fitted_to_fig7().items()}
    stage_tables: list[dict[str, dict[str, TrackingError]]] = []
    for ahead in (0, preview):
        fitted = methods.fitted_to_stage(stage, ahead)
        of_torchpi = {
            trajectory: panel.tracked["torchpi"].error
            for trajectory, panel in context.done["fig12"].panels.items()
        }
        stage_tables.append({**methods.tracked(stage, fitted), "torchpi": of_torchpi})
    panels: dict[str, dict[str, Fig8]] = {
        "known_plant": context.done["fig8"].indirect,
        "torchpi": context.done["fig8"].direct,
    }
    for name, by_hz in panels.items():
        of_fig7[name] = {hz: panel.max_percent for hz, panel in by_hz.items()}
    return MethodsResult(of_fig7, stage_tables[0], stage_tables[1], preview, methods.dilation_on_fast(stage))


@dataclass(frozen=True)
class CalibrationResult(Result):
    """Errors of the paper's method on the stage, and on the stage without one part of its physics."""

    max_um: dict[str, float]  # model, slow, fast
    shares: dict[str, dict[str, float]]  # likewise without one part, by the name of the part

    def numbers(self) -> dict[str, Any]:
        return {
            "calibration": {name: {"max_um": value} for name, value in self.max_um.items()},
            "more": {"calibration_without": self.shares},
        }

    def rows(self) -> list[Row]:
        what = {
            "model": "modelling error on eq. 13 after the initial loading, max",
            "slow": "tracking error, eq. 15, max",
            "fast": "tracking error, eq. 16, max",
        }
        return [
            Row(what[name], value, "µm", PAPER_MAX_UM[name], within_percent=20)
            for name, value in self.max_um.items()
        ]


def compute_calibration(context: Context) -> CalibrationResult:
    return CalibrationResult(
        calibrate_paper_method(context.stage).max_um,
        {part: calibrate_paper_method(without(context.stage, part)).max_um for part in context.size.parts},
    )


@dataclass(frozen=True)
class Fig10Result(Result):
    """The identified model compared with the ideal inversion."""

    figure: identification.Fig10

    def numbers(self) -> dict[str, Any]:
        of = self.figure
        return {
            "more": {
                "fig10": {
                    "whole": asdict(of.whole),
                    "after_loading": asdict(of.after_loading),
                    "condition_number": of.stages.condition_number,
                    "seconds": of.seconds,
                    "c": of.c,
                }
            }
        }

    def rows(self) -> list[Row]:
        of = self.figure
        points = np.array([4.05, 8.1])
        ours, papers = (
            float(np.divide(*identification.saturation(c, points)[::-1]))
            for c in (of.c, identification.EQ_12)
        )
        return [
            Row(
                "model error after the initial loading, max",
                of.after_loading.max_um,
                "µm",
                0.21,
                note="through the local slope of the loop",
            ),
            Row(
                "the same as a voltage",
                of.after_loading.max_v,
                "V",
                note="the paper has 0.21 “µm” of a voltage",
            ),
            Row("model error with the initial loading, max", of.whole.max_um, "µm"),
            Row("the same as a voltage", of.whole.max_v, "V"),
            Row("model error after the initial loading, rms", of.after_loading.rms_um, "µm"),
            Row("S(8.1) / S(4.05)", ours, "", papers, note="eq. 12; the scale of S against w is free"),
            Row(
                "condition number of stage 2",
                of.stages.condition_number,
                note="single weights are not determined",
            ),
            Row("time of both stages", of.seconds, "s", 1200.0, note="the paper: within 20 min"),
        ]


@dataclass(frozen=True)
class Table1Result(Result):
    """Identified k and b of Table I."""

    k: list[float]  # V/µm per µm/s
    b: list[float]  # V/µm

    def numbers(self) -> dict[str, Any]:
        return {"more": {"table1": {"k": self.k, "b": self.b}}}


def compute_table1(context: Context) -> Table1Result:
    figure = context.done["fig10"].figure
    return Table1Result(figure.k, figure.b)


@dataclass(frozen=True)
class Learning(Result):
    """The compensator that torchpi learned from recordings of the stage."""

    hyper_parameters: dict[str, Any]
    state: dict[str, np.ndarray]
    seconds: float

    def compensator(self) -> DirectInverse:
        compensator = DirectInverse(**self.hyper_parameters)
        compensator.load_state_dict({name: torch.from_numpy(value) for name, value in self.state.items()})
        return compensator

    def numbers(self) -> dict[str, Any]:
        return {"more": {"learning": {"seconds": self.seconds, "preview": self.hyper_parameters["preview"]}}}

    def rows(self) -> list[Row]:
        hyper = self.hyper_parameters
        return [
            Row("plays", len(hyper["thresholds"]), paper=10),
            Row("degree of S", hyper["degree"], paper=4),
            Row("look-ahead", hyper["preview"], "samples", 0),
            Row("numbers", sum(one.numel() for one in self.compensator().parameters()), paper=24),
            Row("time to learn", self.seconds, "s", 1200.0, note="the paper: within 20 min"),
        ]


def compute_learning(context: Context) -> Learning:
    start = time.perf_counter()
    compensator = context.recipe.stage(context.stage)
    seconds = time.perf_counter() - start
    state = {name: value.detach().numpy().copy() for name, value in compensator.state_dict().items()}
    return Learning(compensator.hyper_parameters, state, seconds)


KEYS_OF_FIG12 = ("max_um", "rms_um", "max_percent", "rms_percent", "max_um_after_loading")
FIG12_UM = {"slow": -0.22, "fast": -0.23}
AT_MOST_PERCENT, AT_MOST_RMS_PERCENT = 0.5, 0.15


@dataclass(frozen=True)
class Fig12Result(Result):
    """The slow and the fast trajectory, tracked with the paper's method and with torchpi's."""

    panels: dict[str, fig12.Panel]

    def numbers(self) -> dict[str, Any]:
        def of(method: str, attribute: str) -> dict[str, Any]:
            return {
                name: {key: getattr(getattr(panel.tracked[method], attribute), key) for key in KEYS_OF_FIG12}
                for name, panel in self.panels.items()
            }

        return {
            "fig12": {method: of(method, "error") for method in ("paper", "torchpi")},
            "more": {"fig12_on_sensor": {method: of(method, "on_sensor") for method in ("paper", "torchpi")}},
        }

    def rows(self) -> list[Row]:
        rows = []
        for name, panel in self.panels.items():
            equation = {"slow": "eq. 15", "fast": "eq. 16"}[name]
            unit = f"% of {panel.peak_to_peak_um:.3g} µm"
            paper, ours = (panel.tracked[method] for method in ("paper", "torchpi"))
            rows += [
                Row(
                    f"{equation}, the paper's method, max",
                    paper.error.max_um,
                    "µm",
                    abs(FIG12_UM[name]),
                    note=f"signed: {FIG12_UM[name]:+.2f} in the paper, {paper.error.extreme_um:+.3f} here",
                ),
                Row(f"{equation}, its max after loading", paper.error.max_um_after_loading, "µm"),
                Row(
                    f"{equation}, its mean after loading",
                    paper.error.mean_um_after_loading,
                    "µm",
                    note="the paper sees a little negative drift" if name == "slow" else "",
                ),
                Row(
                    f"{equation}, torchpi, max",
                    ours.error.max_percent,
                    unit,
                    {"slow": 3.7, "fast": 3.4}[name],
                    at_most=AT_MOST_PERCENT,
                    note=f"{1e3 * ours.error.max_um:.3g} nm; "
                    f"{ours.error.max_percent_of_travel:.2g} % of 8.1 µm; "
                    f"on the sensor {ours.on_sensor.max_percent:.2g} %",
                ),
                Row(
                    f"{equation}, torchpi, rms",
                    ours.error.rms_percent,
                    unit,
                    at_most=AT_MOST_RMS_PERCENT,
                    note=f"{1e3 * ours.error.rms_um:.3g} nm; "
                    f"on the sensor {ours.on_sensor.rms_percent:.2g} %",
                ),
                Row(
                    f"{equation}, torchpi, max after loading",
                    ours.error.max_percent_after_loading,
                    unit,
                    note=f"{1e3 * ours.error.max_um_after_loading:.3g} nm",
                ),
                Row(
                    f"{equation}, torchpi, samples at a voltage limit",
                    ours.samples_at_limit,
                    note=f"of {len(panel.t):,}; the paper's method {paper.samples_at_limit}",
                ),
            ]
        return rows


def compute_fig12(context: Context) -> Fig12Result:
    compensators = context.streams()
    return Fig12Result({name: fig12.panel(context.stage, name, compensators) for name in fig12.TRAJECTORIES})


@dataclass(frozen=True)
class Fig13Result(Result):
    """Loops before and after compensation: sines by frequency, and the two trajectories."""

    before: dict[str, fig13.Loop]  # by frequency
    after: dict[str, fig13.Loop]
    trajectories: dict[str, fig12.Panel]  # tracked: without, torchpi

    def numbers(self) -> dict[str, Any]:
        return {
            "fig13": {
                when: {
                    hz: {
                        "width_percent": loop.width_percent,
                        "nonlinearity_percent": loop.nonlinearity_percent,
                    }
                    for hz, loop in loops.items()
                }
                for when, loops in (("before", self.before), ("after", self.after))
            }
        }


def compute_fig13(context: Context) -> Fig13Result:
    straight = StraightLine(context.identified.slow)
    torchpi = context.in_one_pass()["torchpi"]
    before, after = (
        {str(hz): fig13.loop(one, context.stage, hz) for hz in context.size.fig13_hz}
        for one in (straight, torchpi)
    )
    both: dict[str, Deployed] = {"without": straight, "torchpi": torchpi}
    panels = {name: fig12.panel(context.stage, name, both) for name in fig12.TRAJECTORIES}
    return Fig13Result(before, after, panels)


@dataclass(frozen=True)
class UnseenResult(Result):
    """Random trajectories, tracked with the paper's method and with torchpi's."""

    trials: dict[str, list[unseen.Trial]]

    def numbers(self) -> dict[str, Any]:
        ours = self.trials["torchpi"]
        by_key = {key: unseen.median_and_worst(ours, key) for key in ("max_percent", "rms_percent")}
        return {
            "unseen": {
                name: {key: values[index] for key, values in by_key.items()}
                for index, name in enumerate(("median", "worst"))
            }
        }

    def rows(self) -> list[Row]:
        unit = "% of peak to peak"
        paper = [unseen.median_and_worst(self.trials["paper"], key) for key in ("max_percent", "rms_percent")]
        ours = [
            unseen.median_and_worst(self.trials["torchpi"], key) for key in ("max_percent", "rms_percent")
        ]
        rows = []
        for size, limit, (median, worst), (paper_median, paper_worst) in zip(
            ("max", "rms"), (AT_MOST_PERCENT, AT_MOST_RMS_PERCENT), ours, paper, strict=True
        ):
            for which, value, of_paper in (("median", median, paper_median), ("worst", worst, paper_worst)):
                note = f"the paper's method on the same: {of_paper:.2g} %"
                rows.append(
                    Row(f"unseen trajectories, {which} of {size}", value, unit, at_most=2 * limit, note=note)
                )
        return rows


def compute_unseen(context: Context) -> UnseenResult:
    seeds = range(unseen.FIRST_SEED, unseen.FIRST_SEED + context.size.unseen)
    return UnseenResult(
        {
            name: [unseen.trial(one, context.stage, seed, context.size.unseen_s) for seed in seeds]
            for name, one in context.in_one_pass().items()
        }
    )


@dataclass(frozen=True)
class ClaimResult(Result):
    """The test of a statement of the paper."""

    name: str
    claim: claims.Claim

    def numbers(self) -> dict[str, Any]:
        return {"more": {"claims": {self.name: {"holds": self.claim.holds, "variants": self.claim.variants}}}}


def trying(name: str) -> Callable[[Context], ClaimResult]:
    def compute(context: Context) -> ClaimResult:
        stage, identified, size = context.stage, context.identified, context.size
        match name:
            case "jointly":
                claim = claims.jointly_against_two_stages(stage, identified, size.evaluations)
            case "above_80hz":
                claim = claims.above_80_hz(stage, context.in_one_pass(), size.above_hz)
            case _:
                claim = claims.CLAIMS[name](stage, identified)
        return ClaimResult(name, claim)

    return compute
