"""Linear, even, odd, non-periodic and noise parts of a residual under a periodic input, without a model.

Pintelon and Schoukens, System Identification: A Frequency Domain Approach (2nd ed. 2012), ch. 4: over whole
periods, the excited lines contain the linear part plus distortion that falls on them; unexcited even and odd
lines contain distortion alone; between the lines of the period lies everything that does not repeat. There,
the median is the noise, and whatever exceeds it is drift, hum or a transient.
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
"""Share of the strongest line's amplitude above which a line counts as excited."""
BAND = 3
"""Multiple of the highest excited frequency, three, up to which distortion is looked for."""
MAINS_HZ, HARMONICS = (50.0, 60.0), 10
"""Lines near these frequencies and their harmonics, if not excited, are not taken for distortion."""
FINE_HZ = 1.0
"""Where lines are closer together than this, those on the mains are hum and count as non-periodic."""
LEAKS = 2.5
"""Multiple of the noise above which the mean of six lines around a line is more than noise."""


@dataclass(frozen=True, eq=False)
class Parts:
    """The parts of the residual of one periodic stretch; a part is None if no line can show it."""

    recording: str
    start_s: float
    period_s: float
    periods: int
    rms_um: dict[Part, float | None]
    """rms of each part above the noise: on the excited lines ("linear"), which also contain odd and even
    distortion, on the even and the odd lines that were not excited, and between lines ("non_periodic")."""
    noise_um: float
    """rms of the noise."""
    significance: dict[Part, float]
    """Significance of each part, in standard deviations of the noise."""
    hz: np.ndarray  # shape: (lines,), lines of the period, without 0
    amplitude_um: np.ndarray  # shape: (lines,), of the residual
    noise_amplitude_um: np.ndarray  # shape: (lines,), expected from the noise alone
    kind: np.ndarray  # shape: (lines,), 'linear', 'even', 'odd' or 'mains'


def multisine(trace: Trace, residual: np.ndarray) -> tuple[Parts, ...]:
    """Return the parts of the residual on each stretch of the recording whose input repeats twice or more.

    Args:
        trace: The recording.
        residual: (time,), µm, one of the trace's residuals: before or after effects are added.
    """
    return tuple(_parts(trace, residual, stretch) for stretch in periodic_stretches(trace.u))


def sentence(parts: Parts) -> str:
    """Return the findings on the lines as a sentence for the report."""
    found = [
        f"{part.replace('_', '-')} {1e3 * size:.3g} nm"
        for part, size in parts.rms_um.items()
        if size and parts.significance[part] > SIGNIFICANT
    ]
    blind = [part for part in ("even", "odd") if parts.rms_um[part] is None]
    text = f"{parts.recording}, {parts.periods} periods of {parts.period_s:.4g} s: "
    text += ", ".join(found) + " (rms) above the noise" if found else "nothing above the noise"
    if blind:
        text += f"; no {' and no '.join(blind)} line was left unexcited, so such distortion cannot be seen"
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
    sizes: dict[Part, float | None] = {}
    significance: dict[Part, float] = {}
    parts: tuple[Part, ...] = ("linear", "even", "odd")
    for part in parts:
        mask = band & (kind == part)
        sizes[part], significance[part] = _over(power[mask], leaked[mask], m) if mask.any() else (None, 0.0)
    hum = (kind == "mains") & (trace.fs_hz / n < FINE_HZ)
    unrepeated = np.concatenate([between[: len(noise) * (m - 1)], power[hum]])
    of_noise = np.concatenate([np.repeat(noise, m - 1)[: len(between)], noise[hum]])
    size, significance["non_periodic"] = _over(unrepeated, of_noise, m)
    # The noise of a period's mean is that of the lowest lines; the drift is the last mean less the first.
    drifts = abs(a_period) * (m - 1) / np.sqrt(m * noise[0])
    significance["non_periodic"] = max(significance["non_periodic"], float(drifts))
    # The non-periodic part also falls on the lines of the period, which are one line in m.
    size = size * np.sqrt(m / (m - 1))
    sizes["linear"] = sizes["linear"] or 0.0
    sizes["non_periodic"] = float(np.hypot(size, drift.std() if drifts > SIGNIFICANT else 0.0))
    return Parts(
        trace.name,
        float(trace.t[stretch.start]),
        n / trace.fs_hz,
        m,
        sizes,
        float(np.sqrt(noise.sum() * m)),
        significance,
        hz,
        np.sqrt(2 * power),
        np.sqrt(2 * noise),
        kind,
    )


def _drift_of_a_period(e: np.ndarray, period: int) -> float:
    """Return the drift of the residual per period, µm, from the difference between successive periods.

    If the drift were left in, its steps at the ends would leak into all lines.
    """
    return float((e[period:] - e[:-period]).mean())


def _on_mains(hz: np.ndarray, spacing_hz: float) -> np.ndarray:
    """Whether hum whose frequency drifts by 0.1 % may show on each line, (lines,), bool."""
    mask = np.zeros(len(hz), dtype=bool)
    for mains_hz in MAINS_HZ:
        multiple = np.maximum(np.round(hz / mains_hz), 1) * mains_hz
        mask |= (np.abs(hz - multiple) < 1e-3 * multiple + 0.5 * spacing_hz) & (
            multiple <= HARMONICS * mains_hz
        )
    return mask


def _told(m: int) -> int:
    """Number of lines between the period's lines whose median gives the noise at a period's line."""
    return 40 * (m - 1)


def _noise(between: np.ndarray, m: int, lines: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean square noise on each line of the period, without and with leakage, (lines,) each.

    The noise is the median of the lines between those of the period. Where nearby ones stand out, a
    non-periodic part such as hum leaks into the line itself as much as into them.
    """
    window = min(_told(m) + 1, len(between))
    typical = median_filter(between, size=window, mode="reflect") / (np.log(2) + 0.5 / window)
    close = uniform_filter1d(between, 6 * (m - 1), mode="nearest")
    at = np.minimum(np.arange(1, lines + 1) * (m - 1), len(between) - 1)
    noise = np.maximum(typical[at], np.finfo(float).tiny)
    return noise, np.where(close[at] > LEAKS * noise, close[at], noise)


def _over(power: np.ndarray, noise: np.ndarray, m: int) -> tuple[float, float]:
    """Return the rms above the noise, and its significance."""
    expected = float(noise.sum())
    above = 2 * expected**2 / float((noise**2).sum())
    # A median of n exponential numbers is worth n ln² 2 of them; neighbouring medians share numbers.
    below = 2 * np.log(2) ** 2 * max(_told(m), len(power))
    score = normal_score(float(power.sum()) / expected, above, below)
    return float(np.sqrt(max(float(power.sum()) - expected, 0.0))), score


def all_parts(traces: Sequence[Trace]) -> tuple[Parts, ...]:
    """Return the parts of the retuned stage's residual for every recording."""
    return tuple(parts for trace in traces for parts in multisine(trace, trace.residual_retuned))
