"""A residual under a periodic input: linear, even, odd, non-periodic and noise parts, before any model.

Pintelon and Schoukens, System Identification: A Frequency Domain Approach (2nd ed. 2012), ch. 4: over whole
periods, what a line of the input excites is the linear part and what distortion puts on it; unexcited even
and odd lines hold distortion alone; between the lines of the period lies what does not repeat. There, the
median is noise, and what stands over it is drift, hum or a transient.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.ndimage import median_filter, uniform_filter1d

from torchpi.diagnosis.diagnosis import Trace
from torchpi.diagnosis.locate import SIGNIFICANT, normal_score
from torchpi.diagnosis.repeats import Stretch, periodic_stretches

Part = Literal["linear", "even", "odd", "non_periodic"]

EXCITED = 1e-3
"""Of the strongest line's amplitude."""
BAND = 3
"""Distortion is looked for up to three times the highest excited frequency."""
MAINS_HZ, HARMONICS = (50.0, 60.0), 10
"""Lines about these, where the input has none, are not taken for distortion."""
FINE_HZ = 1.0
"""Of lines closer than this, those on the mains are hum's, and count as non-periodic."""
LEAKS = 2.5
"""Times the noise, from which six lines about a line are more than noise."""


@dataclass(frozen=True, eq=False)
class Parts:
    """The residual of one periodic stretch, taken apart; None where no line can show a part."""

    recording: str
    start_s: float
    period_s: float
    periods: int
    linear_um: float
    """rms on the excited lines, over the noise; odd and even distortion falls on them too."""
    even_um: float | None
    """rms on the even lines that were not excited, over the noise."""
    odd_um: float | None
    """rms on the odd lines that were not excited, over the noise; excited lines hold their like."""
    non_periodic_um: float
    """rms between the lines, over the noise."""
    noise_um: float
    """rms of the noise."""
    significance: dict[Part, float]
    """Of each part, in standard deviations of the noise."""
    hz: np.ndarray  # shape: (lines,), of the period, without 0
    amplitude_um: np.ndarray  # shape: (lines,), of the residual
    noise_amplitude_um: np.ndarray  # shape: (lines,), to be expected from the noise alone
    kind: np.ndarray  # shape: (lines,), 'linear', 'even', 'odd' or 'mains'


def multisine(trace: Trace, residual: np.ndarray) -> tuple[Parts, ...]:
    """The parts of the residual on every stretch of the recording whose input repeats twice or more.

    Args:
        trace: The recording.
        residual: (time,), µm, the trace's own residual before or after.
    """
    return tuple(_parts(trace, residual, stretch) for stretch in periodic_stretches(trace.u))


def sentence(parts: Parts) -> str:
    """What the lines say, for a reader."""
    sizes: dict[Part, float | None] = {
        "linear": parts.linear_um,
        "even": parts.even_um,
        "odd": parts.odd_um,
        "non_periodic": parts.non_periodic_um,
    }
    found = [
        f"{part.replace('_', '-')} {1e3 * size:.3g} nm"
        for part, size in sizes.items()
        if size and parts.significance[part] > SIGNIFICANT
    ]
    blind = [part for part in ("even", "odd") if sizes[part] is None]
    text = f"{parts.recording}, {parts.periods} periods of {parts.period_s:.4g} s: "
    text += ", ".join(found) + " (rms) over the noise" if found else "nothing over the noise"
    if blind:
        text += f"; no {' and no '.join(blind)} line was left unexcited to show such distortion"
    return text + "."


def _parts(trace: Trace, residual: np.ndarray, stretch: Stretch) -> Parts:
    n, m = stretch.period, stretch.periods
    inside = slice(stretch.start, stretch.start + n * m)
    a_period = _drift_of_a_period(residual[inside], n)
    drift = a_period / n * (np.arange(n * m) - (n * m - 1) / 2)
    level = residual[inside] - drift
    fine = 2 * np.abs(np.fft.rfft(level) / (n * m)) ** 2  # mean square on each line of the whole stretch
    fine[0] = 0.0
    drive = np.abs(np.fft.rfft(trace.u[inside].reshape(m, n).mean(0)))[1 : (n + 1) // 2]
    line = np.arange(1, (n + 1) // 2)
    hz = line * trace.fs_hz / n
    power, between = fine[line * m], np.delete(fine, np.arange(0, len(fine), m))
    noise, leaked = _noise(between, m, len(line))
    excited = drive > EXCITED * drive.max()
    kind = np.where(excited, "linear", np.where(line % 2 == 0, "even", "odd"))
    kind[~excited & _on_mains(hz, trace.fs_hz / n)] = "mains"
    band = line <= BAND * line[excited].max()
    sizes: dict[str, float | None] = {}
    significance: dict[Part, float] = {}
    parts: tuple[Part, ...] = ("linear", "even", "odd")
    for part in parts:
        mask = band & (kind == part)
        sizes[part], significance[part] = _over(power[mask], leaked[mask], m) if mask.any() else (None, 0.0)
    hum = (kind == "mains") & (trace.fs_hz / n < FINE_HZ)
    unrepeated = np.concatenate([between[: len(noise) * (m - 1)], power[hum]])
    of_noise = np.concatenate([np.repeat(noise, m - 1)[: len(between)], noise[hum]])
    size, significance["non_periodic"] = _over(unrepeated, of_noise, m)
    # The mean over a period varies as the lowest lines do; the drift is the last less the first.
    drifts = abs(a_period) * (m - 1) / np.sqrt(m * noise[0])
    significance["non_periodic"] = max(significance["non_periodic"], float(drifts))
    # What repeats not at all lies on the lines of the period as well: one in m.
    size = size * np.sqrt(m / (m - 1))
    return Parts(
        trace.name,
        float(trace.t[stretch.start]),
        n / trace.fs_hz,
        m,
        sizes["linear"] or 0.0,
        sizes["even"],
        sizes["odd"],
        float(np.hypot(size, drift.std() if drifts > SIGNIFICANT else 0.0)),
        float(np.sqrt(noise.sum() * m)),
        significance,
        hz,
        np.sqrt(2 * power),
        np.sqrt(2 * noise),
        kind,
    )


def _drift_of_a_period(e: np.ndarray, period: int) -> float:
    """µm by which the residual drifts in a period, told by what does not repeat.

    Left in, its steps at the ends would leak into all lines.
    """
    return float((e[period:] - e[:-period]).mean())


def _on_mains(hz: np.ndarray, spacing_hz: float) -> np.ndarray:
    """(lines,), bool: where hum that drifts by 0.1 % shows."""
    mask = np.zeros(len(hz), dtype=bool)
    for mains_hz in MAINS_HZ:
        multiple = np.maximum(np.round(hz / mains_hz), 1) * mains_hz
        mask |= (np.abs(hz - multiple) < 1e-3 * multiple + 0.5 * spacing_hz) & (
            multiple <= HARMONICS * mains_hz
        )
    return mask


def _told(m: int) -> int:
    """Lines between the period's lines from whose median the noise at one of them is taken."""
    return 40 * (m - 1)


def _noise(between: np.ndarray, m: int, lines: int) -> tuple[np.ndarray, np.ndarray]:
    """(lines,) each: mean square of the noise on a line of the period, and with what leaks there.

    The noise is the median of the lines between those of the period; where those close by stand out, what
    does not repeat, such as hum, leaks into the line itself, as much as into them.
    """
    window = min(_told(m) + 1, len(between))
    typical = median_filter(between, size=window, mode="reflect") / (np.log(2) + 0.5 / window)
    close = uniform_filter1d(between, 6 * (m - 1), mode="nearest")
    at = np.minimum(np.arange(1, lines + 1) * (m - 1), len(between) - 1)
    noise = np.maximum(typical[at], np.finfo(float).tiny)
    return noise, np.where(close[at] > LEAKS * noise, close[at], noise)


def _over(power: np.ndarray, noise: np.ndarray, m: int) -> tuple[float, float]:
    """rms over the noise, and its significance."""
    expected = float(noise.sum())
    above = 2 * expected**2 / float((noise**2).sum())
    # A median of n exponential numbers is worth n ln² 2 of them; neighbouring medians share theirs.
    below = 2 * np.log(2) ** 2 * max(_told(m), len(power))
    score = normal_score(float(power.sum()) / expected, above, below)
    return float(np.sqrt(max(float(power.sum()) - expected, 0.0))), score


def all_parts(traces: Sequence[Trace]) -> tuple[Parts, ...]:
    """Of the retuned stage's residual, for every recording."""
    return tuple(parts for trace in traces for parts in multisine(trace, trace.residual_retuned))
