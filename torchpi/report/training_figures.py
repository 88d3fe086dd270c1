"""Figures of a training run; each function takes the result and returns a matplotlib Figure."""

from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from torchpi.report import style
from torchpi.report.style import canvas, legend_above
from torchpi.report.traces import Signal, envelope, thinned
from torchpi.report.training import RecordFit, Saturation, WeightsAgainstRate

RECORDED: dict[str, Any] = {"color": "#000000", "linestyle": "-", "linewidth": 1.6, "alpha": 0.75}
PREDICTED: dict[str, Any] = {"color": "#E69F00", "linestyle": (0, (3, 1.2)), "linewidth": 1.2}


def loop_figure(record: RecordFit) -> Figure:
    """Draw the hysteresis: recorded and predicted voltage against the recorded displacement."""
    with canvas(3.6, 0.62 * style.WIDTH_IN) as figure:
        axes = figure.subplots()
        axes.plot(*thinned(record.y, record.u), label="recorded", **RECORDED)
        axes.plot(*thinned(record.y, record.u_hat), label="predicted", **PREDICTED)
        axes.set(xlabel="displacement y (µm)", ylabel="voltage u (V)", title=f"{record.name}, {record.role}")
        axes.legend(loc="upper left")
    return figure


def traces_figure(record: RecordFit) -> Figure:
    """Draw recorded and predicted voltage against time, and the residual."""
    with canvas(3.8) as figure:
        voltage, residual = figure.subplots(2, 1, sharex=True)
        voltage.plot(*envelope(record.t, record.u), label="recorded", **RECORDED)
        voltage.plot(*envelope(record.t, record.u_hat), label="predicted", **PREDICTED)
        voltage.set(ylabel="voltage u (V)", title=f"{record.name}, {record.role}")
        legend_above(voltage, 2)
        residual.plot(*envelope(record.t, 1e3 * (record.u_hat - record.u)), color="#0072B2", linewidth=0.8)
        residual.axhline(0.0, color="#000000", linewidth=0.6)
        residual.set(
            ylabel="residual (mV)",
            title="residual, predicted − recorded",
            xlabel="time (s)",
            xlim=(record.t[0], record.t[-1]),
        )
    return figure


def spectrum_figure(record: RecordFit) -> Figure:
    """Draw the residual's spectrum; lines that stand out are structure that the model has not captured."""
    with canvas(2.9) as figure:
        axes = figure.subplots()
        dt_s = float(np.median(np.diff(record.t)))
        for signal, label, color, width in (
            (record.u, "voltage", "#999999", 1.8),
            (record.u_hat - record.u, "residual", "#0072B2", 1.0),
        ):
            f, density = _amplitude_density(signal, dt_s)
            axes.plot(f, density, label=label, color=color, linewidth=width)
        axes.set(
            xscale="log",
            yscale="log",
            xlabel="frequency (Hz)",
            ylabel="V per √Hz",
            title=f"spectrum, {record.name}, {record.role}",
        )
        legend_above(axes, 2)
    return figure


def weights_figure(weights: WeightsAgainstRate) -> Figure:
    """Draw eq. 7: each play's weight against the rate, and their running sum, the slope of the loop."""
    with canvas(3.5) as figure:
        single, running = figure.subplots(1, 2)
        plays = len(weights.r)
        colours = matplotlib.colormaps["cividis"](np.linspace(0.0, 0.92, plays))
        dashes = ("-", (0, (4, 1.5)), (0, (1, 1.2)))
        for i, r in enumerate(weights.r):
            single.plot(
                weights.rate,
                weights.w[:, i],
                color=colours[i],
                linestyle=dashes[i % 3],
                label=f"{r:.3g}",
                lw=1.1,
            )
        single.set(
            xlabel="rate ẏ (µm/s)",
            ylabel="weight wᵢ(ẏ) (V per unit of S)",
            title="weights against rate",
        )
        single.legend(
            title="threshold rᵢ",
            title_fontsize=8,
            loc="upper center",
            bbox_to_anchor=(0.5, -0.2),
            ncols=5,
            columnspacing=0.9,
            handlelength=1.6,
        )
        at_zero = int(np.argmin(np.abs(weights.rate)))
        for k, line in ((0, style.OTHERS[0]), (at_zero, style.TORCHPI), (-1, style.OTHERS[1])):
            running.plot(
                weights.r,
                np.cumsum(weights.w[k]),
                marker="o",
                markersize=3,
                label=f"{weights.rate[k]:.3g} µm/s",
                **line,
            )
        running.axhline(0.0, **style.LIMIT)
        running.set(
            xlabel="threshold rⱼ (unit of S)",
            ylabel="Σ wᵢ, i ≤ j (V per unit of S)",
            title="their running sum: slope of the loop",
        )
        running.legend(loc="best")
    return figure


def saturation_figure(saturation: Saturation) -> Figure:
    """Draw eq. 4: S against the line of its slope at zero, and the slope of S."""
    with canvas(2.7) as figure:
        value, slope = figure.subplots(1, 2)
        value.plot(saturation.y, saturation.s, label="S(y)", **style.TORCHPI)
        value.plot(saturation.y, saturation.c[0] * saturation.y, label="c₁ y", **style.LIMIT)
        value.set(ylabel="S", title="saturation polynomial")
        value.legend(loc="upper left")
        slope.plot(saturation.y, _slope(saturation), **style.TORCHPI)
        slope.set(ylabel="slope S′ (per µm)", title="its slope")
        slope.set_ylim(bottom=min(0.0, slope.get_ylim()[0]))
        for axes in (value, slope):
            axes.set_xlabel("displacement y (µm)")
    return figure


def _slope(saturation: Saturation) -> Signal:
    powers = np.arange(1, len(saturation.c) + 1)
    slope: Signal = (powers * saturation.c * saturation.y[:, None] ** (powers - 1)).sum(axis=1)
    return slope


def _amplitude_density(x: Signal, dt_s: float) -> tuple[Signal, Signal]:
    """Welch's estimate with half-overlapping Hann windows, as the maximum in 150 columns per decade."""
    window = min(len(x), 8192)
    hann = np.hanning(window)
    starts = range(0, len(x) - window + 1, max(window // 2, 1))
    segments = np.array([hann * (x[k : k + window] - x[k : k + window].mean()) for k in starts])
    power = (np.abs(np.fft.rfft(segments)) ** 2).mean(axis=0) * 2.0 * dt_s / (hann @ hann)
    f, density = np.arange(1, len(power)) / (window * dt_s), np.sqrt(power[1:])
    columns = np.unique(np.round(150 * np.log10(f)).astype(int), return_index=True)[1]
    highest: Signal = np.maximum.reduceat(density, columns)
    return f[columns], highest
