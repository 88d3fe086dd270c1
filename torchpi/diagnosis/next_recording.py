"""The next recording: the one that would decide between the explanations that are still open."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from torchpi.diagnosis.deciding_excitation import Movement, stretch
from torchpi.diagnosis.diagnosis import NextRecording
from torchpi.diagnosis.splits import CONFIRM, DETERMINE, NAMELESS, SHOWS, SPLITS, Decision
from torchpi.excitation.limits import DriveLimits, recorded
from torchpi.excitation.signals import Samples
from torchpi.stage.effects.effect import DataRange

MOST_SAMPLES = 600_000
LEAST_RATE = 2.0  # ranges per second: any stage that has crossed its range is assumed to tolerate this


def next_recording(
    open_names: Sequence[str],
    seen: DataRange,
    *,
    determined: bool = True,
    unexplained: bool = False,
    seed: int = 1,
) -> tuple[NextRecording, Samples]:
    """Return the recording that best separates the leading candidates, and the voltage to play for it.

    Args:
        open_names: The effects between which these recordings cannot decide, the likeliest first; a single
            name if that effect is only uncertain; empty if nothing is open.
        seen: What the recordings span. The voltage stays within their voltage range, and within their rate
            if that rate crosses the range twice a second or faster.
        determined: Whether the hysteresis is known for other motions; if not, determining it comes first.
        unexplained: Whether part of the residual has no name yet; only counts if no name is open.
        seed: Seed of the random phases; unlike that of `torchpi excite`, so that recordings are independent.

    Returns:
        The reason and the movement, in words; and t (time,), s, and u (time,), V, from 0 V and back to 0 V,
        at the recordings' sample rate, halved until there are no more than MOST_SAMPLES samples.
    """
    decision = _decision(open_names, unexplained) if determined else DETERMINE
    if seen.low_v == seen.high_v == 0:
        why = "The voltage never left 0 V in these recordings, so they do not show what the stage tolerates."
        what = (
            "torchpi excite --for diagnosis, with the limits of your stage; next_excitation.csv only "
            "holds 0 V."
        )
        samples = min(MOST_SAMPLES, math.ceil(5 * max(50.0, seen.fs_hz)))
        return NextRecording(why, what), (np.arange(samples) / seen.fs_hz, np.zeros(samples))
    limits = _limits(seen, decision.movement)
    t, u = recorded(limits, decision.movement.make(limits, seed))
    return NextRecording(decision.why, _in_words(decision.movement, limits, u)), (t, u)


def _decision(open_names: Sequence[str], unexplained: bool) -> Decision:
    for pair in combinations(open_names, 2):
        if frozenset(pair) in SPLITS:
            return SPLITS[frozenset(pair)]
    known = [name for name in open_names if name in SHOWS]
    if len(known) > 1:
        first, second = (name.replace("_", " ") for name in known[:2])
        alike = f"{first.capitalize()} and {second} look alike in these recordings. "
        shown = SHOWS[known[0]]
        return replace(shown, why=alike + shown.why)
    if known:
        return SHOWS[known[0]]
    return NAMELESS if unexplained or open_names else CONFIRM


def _limits(seen: DataRange, movement: Movement) -> DriveLimits:
    """Return the drive limits that, according to the recordings, the stage tolerates."""
    low_v, high_v = min(0.0, seen.low_v), max(0.0, seen.high_v)
    span_v, longer = high_v - low_v, stretch(seen.fs_hz)
    rate_v_s = max(seen.max_rate_v_s, LEAST_RATE * span_v / longer)
    halvings = max(0, math.ceil(math.log2(seen.fs_hz * longer * movement.seconds / MOST_SAMPLES)))
    fs_hz = seen.fs_hz / 2**halvings
    # Far above the frequency of a full-range triangle at this rate, only tiny amplitudes are possible.
    high_hz = min(fs_hz / 5, 10 * rate_v_s / span_v)
    return DriveLimits(low_v, high_v, rate_v_s, fs_hz, high_hz)


def _in_words(movement: Movement, limits: DriveLimits, u: np.ndarray) -> str:
    fs_hz = limits.sample_rate_hz
    return (
        f"next_excitation.csv: {movement.words}; {len(u) / fs_hz:.3g} s at {fs_hz:g} Hz, "
        f"{u.min():.4g} to {u.max():.4g} V, at most {np.abs(np.diff(u)).max() * fs_hz:.4g} V/s"
    )
