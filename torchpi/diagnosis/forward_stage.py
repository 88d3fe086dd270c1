"""A forward stage of the recordings: static hysteresis by least squares on plays, then linear dynamics.

    y = M{ C[ Σ_i w_i h_i(S(v)) ] } + y_0,    v = u delayed or lagged

with a zero y_0 for each recording (Kuhnen, *European Journal of Control* 9(4), 2003, for the plays). Delay,
lag, curvature S of the input, creep C, mode M, and a history before the first sample are tried one after
another. Each is kept only if it improves the prediction of samples that no fit has seen: the end of each
recording, and its start-up. The last fit uses the number of plays that predicts those samples best, and is
made to all samples.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.fit import fit
from torchpi.diagnosis.hypothesis import EffectTerm, Fit, Hypothesis
from torchpi.diagnosis.hysteresis_model import many_plays, plays_of, thresholds
from torchpi.diagnosis.model import augmented_stage
from torchpi.diagnosis.records import not_counting, prepare, seen
from torchpi.errors import RecordingError
from torchpi.recordings.faults import noise_estimate
from torchpi.recordings.identity import recordings_sha256
from torchpi.recordings.recording import Recording
from torchpi.stage import Stage
from torchpi.stage.effects.actuator.creep import Creep
from torchpi.stage.effects.actuator.input_nonlinearity import InputNonlinearity
from torchpi.stage.effects.amplifier.amplifier_lag import AmplifierLag
from torchpi.stage.effects.amplifier.delay import Delay
from torchpi.stage.effects.effect import DataRange, Effect, Parameters
from torchpi.stage.effects.mechanics.resonance import Resonance
from torchpi.stage.identified import Identified

FINE, EVEN = 6, 20
"""Numbers of plays during the search: spaced logarithmically, and evenly."""
LEAST = 0.02
"""Share by which an effect must lower the error on unseen samples."""
MOST_SAMPLES = 400_000
"""Maximum number of samples of all recordings together; of longer ones only the beginnings are used."""
MODES = 2
"""Number of frequencies from which a mode is fitted; other effects are fitted from their best start only."""
ROUGH = 3e-3
"""Relative gain of a step below which a fit of the search ends."""
START_AWAY = 0.02
"""Share of the command's span: a recording that begins beyond it may have a history before its start."""
DAMPING_RATIO = 0.02
"""Damping ratio at which the fit of a mode starts: from a start that hardly rings, none is found."""


@dataclass(frozen=True)
class Step:
    """One form of the stage on the way to the result.

    Attributes:
        names: Names of its effects.
        unseen_rms_um: Its error on the ends of the recordings, which were not fitted, µm.
    """

    names: tuple[str, ...]
    unseen_rms_um: float


@dataclass(frozen=True)
class ForwardStage:
    """An identified stage and the steps that led to it, beginning with the plays alone."""

    stage: Stage
    steps: tuple[Step, ...]


def identify_stage(
    train: Sequence[Recording],
    heldout: Recording,
    *,
    judged: slice | None = None,
    skip_s: float = 0.0,
    log: Callable[[str], None] = lambda text: None,
) -> ForwardStage:
    """Identify a stage from recordings, all at one sample rate, and judge it on another recording.

    Args:
        train: The recordings to fit; first sample de-energised, or fitted with a history.
        heldout: The recording that the stage is judged on; nothing is fitted to it or chosen by it.
        judged: The samples of `heldout` that count; None for all after `skip_s`.
        skip_s: Start-up transient, s, that is not counted.
        log: Called with a description of each attempt.

    Raises:
        RecordingError: No recording, or none in which the voltage moves.
    """
    if not train or all(np.ptp(recording.u) == 0 for recording in train):
        raise RecordingError("recordings: found none in which the voltage moves, expected at least one")
    used = _beginnings(train)
    wrong = [not_counting(one) for one in used]
    search = _Search(Chain(prepare(used, wrong, skip_s)), log)
    best = search.run()
    log("everything refitted to all samples")
    last = fit(Chain(prepare(used, wrong, skip_s, sealed=0.0)), best.hypothesis, best.weights)
    noise_um = float(np.median([noise_estimate(one.y) for one in used]))
    stage = augmented_stage(last, len(used), search.seen, noise_um)
    error = free_run_error(stage, heldout)[judged or slice(round(skip_s * heldout.fs_hz), None)]
    identified = Identified(
        recordings_sha256(train), heldout.source or heldout.name, float(error.std()), _largest(error)
    )
    # The voltage range that the stage is valid for includes that of the recording it is judged on.
    limits = {
        "min_voltage_v": min(stage.min_voltage_v, float(heldout.u.min())),
        "max_voltage_v": max(stage.max_voltage_v, float(heldout.u.max())),
    }
    settings = {**stage.to_dict(), **limits, "identified": identified.plain()}
    return ForwardStage(Stage.from_dict(settings), tuple(search.steps))


def free_run_error(stage: Stage, recording: Recording) -> np.ndarray:
    """Recorded less simulated y from the de-energised state, (time,), µm; it contains the sensor's zero."""
    with torch.no_grad():
        y, _ = stage.at_sample_rate(recording.fs_hz)(torch.from_numpy(recording.u.astype(np.float64))[None])
    return np.asarray(recording.y - y[0].numpy())


def _largest(error: np.ndarray) -> float:
    return float(np.abs(error - error.mean()).max())


def _beginnings(recordings: Sequence[Recording]) -> list[Recording]:
    """Return the recordings, each cut to its equal share of `MOST_SAMPLES` if it is longer."""
    most = MOST_SAMPLES // len(recordings)
    return [
        one if len(one) <= most else one.split_tail((len(one) - most) / len(one))[0] for one in recordings
    ]


class _Search:
    def __init__(self, chain: Chain, log: Callable[[str], None]) -> None:
        self.chain, self.log = chain, log
        self.seen: DataRange = seen(chain.records)
        self.steps: list[Step] = []

    def run(self) -> Fit:
        """Return the form that predicts unseen samples best, fitted to the other samples."""
        few = plays_of(self.seen, thresholds(self.seen, FINE, EVEN))
        self.log(f"hysteresis, {few.size} plays")
        now = self.taken(fit(self.chain, Hypothesis(few)))
        # Two passes: an effect that others hide in the first may show once they are in the model.
        tried: set[tuple[str, tuple[str, ...]]] = set()
        for _ in range(2):
            for attempt in (self.timing, self.curvature, self.creep, self.mode, self.history):
                key = (attempt.__name__, now.hypothesis.names)
                if key in tried:
                    continue
                tried.add(key)
                now = self.better(now, attempt(now))
        now = self.without_the_needless(now)
        many = many_plays(self.seen)
        self.log(f"hysteresis, {many.size} plays")
        return self.better(now, [fit(self.chain, now.hypothesis.on(many))], at_least=0.0)

    def taken(self, one: Fit) -> Fit:
        names = (*one.hypothesis.names, *(("history",) if one.hypothesis.remanent else ()))
        self.steps.append(Step(names, one.heldout_rms))
        return one

    def better(self, now: Fit, fits: Sequence[Fit], at_least: float = LEAST) -> Fit:
        """The best fit with nothing new on a bound if it predicts unseen samples better; else `now`."""
        inside = [one for one in fits if set(one.bounded) <= set(now.bounded)]
        best = min(inside, key=lambda one: one.heldout_rms, default=now)
        lower = best.heldout_rms < (1 - at_least) * now.heldout_rms and best.train_rms < now.train_rms
        return self.taken(best) if lower else now

    def without_the_needless(self, now: Fit) -> Fit:
        """Remove effects that others, found later, have made redundant."""
        self.log("each effect left out in turn")
        for name in now.hypothesis.names:
            less = fit(self.chain, now.hypothesis.without(name), now.weights, tolerance=ROUGH)
            if less.heldout_rms < (1 + LEAST) * now.heldout_rms:
                now = self.taken(less)
        return now

    def timing(self, now: Fit) -> list[Fit]:
        """Fit a delay, and a lag, unless they are already in the model."""
        lags = [start for start in AmplifierLag.starts(self.seen) if "damping_ratio" not in start]
        return [
            *self.with_effect(now, Delay, Delay.starts(self.seen)),
            *self.with_effect(now, AmplifierLag, lags),
        ]

    def curvature(self, now: Fit) -> list[Fit]:
        """Fit a polynomial of the third degree before the plays."""
        return self.with_effect(now, InputNonlinearity, InputNonlinearity.starts(self.seen)[-1:])

    def creep(self, now: Fit) -> list[Fit]:
        """Fit logarithmic creep, and a single relaxation."""
        starts = [one for one in Creep.starts(self.seen) if not {"power_per_decade", "slow_gain"} & {*one}]
        logarithm = [one for one in starts if "per_decade" in one]
        return [
            *self.with_effect(now, Creep, logarithm),
            *self.with_effect(now, Creep, [one for one in starts if one not in logarithm]),
        ]

    def mode(self, now: Fit) -> list[Fit]:
        """Fit a resonance; a delay, which may have stood in for it, starts at half its value."""
        starts = [{**one, "damping_ratio": DAMPING_RATIO} for one in Resonance.starts(self.seen)]
        shared = [
            replace(member, shared={"delay_s": member.shared["delay_s"] / 2})
            if member.effect is Delay
            else member
            for member in now.hypothesis.members
        ]
        base = replace(now.hypothesis, members=tuple(shared))
        return self.with_effect(now, Resonance, starts, base, MODES)

    def history(self, now: Fit) -> list[Fit]:
        """Fit a history before each recording, if any recording begins with a voltage applied."""
        away = START_AWAY * self.chain.span_v
        if now.hypothesis.remanent or all(abs(one.u[0]) <= away for one in self.chain.records):
            return []
        self.log("history before the first sample")
        return [fit(self.chain, replace(now.hypothesis, remanent=True), None, tolerance=ROUGH)]

    def with_effect(
        self,
        now: Fit,
        kind: type[Effect],
        starts: Sequence[Parameters],
        base: Hypothesis | None = None,
        most: int = 1,
    ) -> list[Fit]:
        """Fit one more effect, from the `most` starts that explain most before they are fitted."""
        base = base or now.hypothesis
        if not starts or kind.name in base.names:
            return []
        self.log(kind.name.replace("_", " "))
        forms = [base.plus(EffectTerm(kind, start)) for start in starts]
        if len(forms) > most:
            forms.sort(key=lambda form: fit(self.chain, form, None, 0).train_rms)
        return [fit(self.chain, form, now.weights, tolerance=ROUGH) for form in forms[:most]]
