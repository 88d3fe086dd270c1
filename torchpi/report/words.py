"""Formatting of numbers and sentences for reports."""

import math
from collections.abc import Callable, Mapping

from torchpi.loop.result import COMPENSATED, LoopResult

METRICS = {
    "train": "trained on",
    "heldout": "held out",
    "loading_excluded": "held out, without initial loading",
    "baseline_lstsq": "held out, two-stage least squares",
    "baseline_plays": "held out, least squares on plays",
}
"""Descriptions of the errors of a training run, by their keys in metrics.json."""


def headline(result: LoopResult) -> str:
    """Return the result in one sentence."""
    whole = result.compensated.on_true.whole
    latency = result.compensated.latency
    return (
        f"Tracks {result.title} to {figure(whole.rms_um)} µm rms and {figure(whole.max_um)} µm at most "
        f"({figure(whole.rms_percent)} % and {figure(whole.max_percent)} % "
        f"of {figure(result.peak_to_peak_um, 2)} µm), "
        f"{times(result.improvement[COMPENSATED].whole_rms)} than without compensation (rms); "
        f"a step takes {figure(latency.median_us, 2)} µs of the {figure(latency.period_us)} µs period; "
        f"{latency.missed:,} of {latency.steps:,} deadlines missed."
    )


def answer(result: LoopResult) -> tuple[str, str]:
    """Return the main number, and what it is."""
    times_better = times(result.improvement[COMPENSATED].whole_rms)
    return (
        length(result.compensated.on_true.whole.rms_um),
        f"rms tracking error on {result.title}: {times_better} than without compensation",
    )


def limits(result: LoopResult) -> list[str]:
    """Say where the compensated drive met a limit of the voltage or its rate, a sentence for each."""
    sentences = []
    for one in result.compensated.limits_met:
        unit, name = ("V", "voltage") if one.quantity == "voltage" else ("V/s", "rate of the voltage")
        largest = f"{one.value:.6g}"
        beyond = "" if largest == f"{one.limit:.6g}" else f" (at most {largest} {unit})"
        longest = "" if one.stretches == 1 else f", the longest of {one.stretches:,} stretches"
        sentences.append(
            f"On {result.title} the {name} reaches its limit of {one.limit:.6g} {unit}{beyond} from "
            f"{one.time_s:.6g} s for {1e3 * one.duration_s:.4g} ms{longest}, at y_d = {one.yd_um:.4g} µm; "
            f"in total, {figure(100 * one.share, 2)} % of the samples."
        )
    if not sentences:
        sentences = [f"On {result.title} neither the voltage nor its rate reaches a limit."]
    if share := result.compensated.beyond_trained_share:
        sentences.append(
            f"{figure(100 * share, 2)} % of the samples lie beyond the trained range or rates, where the "
            "compensator extrapolates and leaves out its lead: train on a recording of such motions."
        )
    return sentences


def loops(result: LoopResult) -> str:
    """Say what the loops of the error show, and how wide they are."""
    before, after = (
        f"{figure(drive.loop_width_percent, 2)} %" for drive in (result.without, result.compensated)
    )
    return (
        "Tracking error against displacement, without and with compensation; on the right, with "
        f"compensation on its own scale. The loop is {before} of peak to peak wide without compensation, "
        f"{after} with it."
    )


def table(result: LoopResult) -> str:
    """Return the true-displacement errors of every drive as a plain-text table for the terminal."""
    lines = [
        f"{result.title:28}{'loading, µm':^20}{'steady, µm':^20}{'whole, µm':^20}{'whole, %':^16}",
        f"{'':28}" + f"{'max':>9}{'rms':>9}  " * 3 + f"{'max':>7}{'rms':>7}",
    ]
    for drive in result.drives.values():
        t = drive.on_true
        parts = "".join(
            f"{figure(e.max_um):>9}{figure(e.rms_um):>9}  " for e in (t.loading, t.steady, t.whole)
        )
        lines.append(
            f"{drive.label:28}{parts}{figure(t.whole.max_percent):>7}{figure(t.whole.rms_percent):>7}"
        )
    return "\n".join(lines)


def training_answer(metrics: Mapping[str, Mapping[str, float]]) -> tuple[str, str]:
    """Return the main number, and what it is."""
    part, where = ("heldout", "on held-out recordings") if "heldout" in metrics else ("train", "in training")
    return length(metrics[part]["rms_um"]), f"rms error of the predicted voltage {where}, as displacement"


def training_headline(metrics: Mapping[str, Mapping[str, float]]) -> str:
    """Return the outcome of a training in one sentence, on held-out recordings if there are any."""
    part, where = ("heldout", "on held-out recordings") if "heldout" in metrics else ("train", "in training")
    error = metrics[part]
    sentence = (
        f"Predicts the voltage {where} to {figure(error['rms_v'])} V rms "
        f"and {figure(error['max_v'])} V at most: "
        f"{figure(error['rms_um'])} µm rms ({figure(error['rms_percent'])} % of peak to peak)"
    )
    if "baseline_lstsq" in metrics and error["rms_um"] > 0.0:
        sentence += (
            f", {times(metrics['baseline_lstsq']['rms_um'] / error['rms_um'])} than two-stage least squares"
        )
    return sentence + "."


def length(value_um: float, digits: int = 3) -> str:
    """Format a length in a suitable unit: 21.3 nm, 4.10 µm."""
    nm = abs(value_um) < 1.0
    return f"{figure((1e3 if nm else 1.0) * value_um, digits)} {'nm' if nm else 'µm'}"


def figure(value: float, digits: int = 3) -> str:
    """Format a number to `digits` significant digits, without an exponent: 0.0213, 4.10, 127."""
    if not math.isfinite(value):
        return "∞" if value > 0 else "−∞" if value < 0 else "not a number"
    if value == 0.0:
        return "0"
    decimals = max(digits - 1 - math.floor(math.log10(abs(value))), 0)
    return f"{value:,.{decimals}f}".replace("-", "−")


def times(ratio: float) -> str:
    """Format a ratio as '14 times better', rounded so that it never sounds better than it is."""
    if ratio >= 1.0:
        return f"{_one_decimal_below_ten(ratio, math.floor)} times better"
    return f"{_one_decimal_below_ten(1.0 / ratio if ratio > 0.0 else math.inf, math.ceil)} times worse"


def _one_decimal_below_ten(ratio: float, to_integer: Callable[[float], int]) -> str:
    if not math.isfinite(ratio):
        return "∞"
    # A ten-thousandth of slack, so that a ratio of exactly 1.3 is not read as 1.2 or 1.4.
    slack = 1e-4 if to_integer is math.floor else -1e-4
    if ratio >= 10.0:
        return f"{to_integer(ratio + slack):,}"
    return f"{to_integer(10.0 * ratio + slack) / 10.0:.1f}"
