"""Whether one nominal stage fits all recordings, or some recordings need a different one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from torchpi.diagnosis.diagnosis import Trace
from torchpi.diagnosis.locate import SIGNIFICANT
from torchpi.recordings.faults import robust_sd

BLOCKS = 20
"""Number of stretches of a recording, as long as possible, that count as independent."""
LEAST_SHARE = 0.2
"""Least share of a recording's mismatch over the floor that its own gain and offset must remove."""


@dataclass(frozen=True)
class GainAndOffset:
    """Gain and offset that the residual of one recording calls for, given the stage fitted to all."""

    recording: str
    gain: float
    """Relative to the stage's gain; 0 means no difference."""
    gain_sd: float
    offset_um: float
    offset_sd_um: float
    share: float
    """Share of the recording's squared residual over the floor that both together remove."""


def conflict(traces: Sequence[Trace], noise_floor_um: float) -> tuple[str, ...]:
    """Return a sentence for each recording that needs another gain or offset than the rest; () if they agree.

    A gain and an offset are fitted to each recording's residual. A recording is in conflict if one of them
    differs from that of the other recordings by more than `SIGNIFICANT` standard deviations, and if both
    together remove a fifth of its mismatch. The standard deviations come from cutting the recording into
    twenty stretches (a sandwich estimator with stretches as clusters: Liang and Zeger 1986), so that a slow
    residual counts as few observations. The sentence says whether the named effects resolve the conflict.

    Args:
        traces: The recordings.
        noise_floor_um: Standard deviation of the noise, µm.
    """
    if len(traces) < 2:
        return ()
    before = [gain_and_offset(trace, trace.residual_retuned, noise_floor_um) for trace in traces]
    after = [gain_and_offset(trace, trace.residual_augmented, noise_floor_um) for trace in traces]
    remains = {i for i, _, _, _ in _apart(after)}
    return tuple(
        f"Recording {before[i].recording} needs {what} the others ({difference}): "
        + (
            "another stage, load or sensor setting, or physics that the named effects do not cover."
            if i in remains
            else "the named effects account for this."
        )
        for i, _, what, difference in _apart(before)
    )


def gain_and_offset(trace: Trace, residual: np.ndarray, noise_floor_um: float) -> GainAndOffset:
    """Fit gain and offset to the residual of a recording, with their standard deviations."""
    modelled = trace.y - residual
    rows = np.stack([modelled - modelled.mean(), np.ones_like(modelled)])
    size = np.maximum((rows**2).sum(1), 1e-150)  # its square must not underflow
    value = rows @ residual / size
    left = residual - value @ rows
    starts = np.linspace(0, len(left), BLOCKS + 1).astype(int)[:-1]
    scores = np.add.reduceat(rows * left, starts, axis=1)
    clustered = (scores**2).sum(1) * BLOCKS / (BLOCKS - 2) / size**2
    sd = np.sqrt(clustered + noise_floor_um**2 / size)
    mismatch = float((residual**2).sum()) - len(residual) * noise_floor_um**2
    gained = float((residual**2).sum() - (left**2).sum())
    share = min(gained / mismatch, 1.0) if mismatch > 0 else 0.0
    return GainAndOffset(trace.name, float(value[0]), float(sd[0]), float(value[1]), float(sd[1]), share)


def _apart(found: Sequence[GainAndOffset]) -> list[tuple[int, float, str, str]]:
    """Index, significance and wording for each recording that differs from the rest."""
    apart = []
    for i, own in enumerate(found):
        if own.share < LEAST_SHARE:
            continue
        others = [other for j, other in enumerate(found) if j != i]
        gain, gain_sd = _pooled([(o.gain, o.gain_sd) for o in others])
        offset, offset_sd = _pooled([(o.offset_um, o.offset_sd_um) for o in others])
        by_gain = (own.gain - gain) / np.hypot(own.gain_sd, gain_sd)
        by_offset = (own.offset_um - offset) / np.hypot(own.offset_sd_um, offset_sd)
        if max(abs(by_gain), abs(by_offset)) <= SIGNIFICANT:
            continue
        if abs(by_gain) >= abs(by_offset):
            difference, sd = 100 * (own.gain - gain), 100 * np.hypot(own.gain_sd, gain_sd)
            what = "a larger gain than" if difference > 0 else "a smaller gain than"
            apart.append((i, abs(by_gain), what, f"{difference:+.2g} ± {sd:.1g} %".replace("-", "−")))
        else:
            difference, sd = 1e3 * (own.offset_um - offset), 1e3 * np.hypot(own.offset_sd_um, offset_sd)
            text = f"{difference:+.3g} ± {sd:.1g} nm".replace("-", "−")
            apart.append((i, abs(by_offset), "a different offset from", text))
    # With two recordings neither is the odd one out: report only the more significant difference.
    return apart if len(found) > 2 else sorted(apart, key=lambda one: -one[1])[:1]


def _pooled(values: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """The median and its standard deviation, from the uncertainties of the values and from their spread."""
    middle = float(np.median([value for value, _ in values]))
    own = float(np.median([sd for _, sd in values])) / np.sqrt(len(values))
    spread = float(robust_sd(np.array([value - middle for value, _ in values]))) / np.sqrt(len(values))
    return middle, float(np.hypot(own, spread))
