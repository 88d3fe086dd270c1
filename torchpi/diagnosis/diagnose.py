"""Recordings in, a diagnosis out: locate, name, model, and show the fit improve."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.compressed import compressed
from torchpi.diagnosis.conflict import conflict
from torchpi.diagnosis.coverage import cannot_be_decided
from torchpi.diagnosis.decide import Decision, decide
from torchpi.diagnosis.diagnosis import Diagnosis, Errors, NamedEffect, Parameter, Trace, Verdict
from torchpi.diagnosis.fit import fit, rms
from torchpi.diagnosis.hypothesis import Fit, Hypothesis
from torchpi.diagnosis.locate import locate
from torchpi.diagnosis.model import augmented_stage
from torchpi.diagnosis.next_recording import next_recording
from torchpi.diagnosis.noise import noise_floor_um
from torchpi.diagnosis.nominal import plain
from torchpi.diagnosis.records import Record, prepare, seen, whole
from torchpi.diagnosis.remainder import with_remainder
from torchpi.diagnosis.say import nm, paragraph
from torchpi.diagnosis.search import Search
from torchpi.diagnosis.simulation import given_members, simulated, simulated_output
from torchpi.diagnosis.slips import unaided
from torchpi.errors import RecordingError
from torchpi.recordings.recording import Recording
from torchpi.stage import Stage
from torchpi.stage.effects.sensor.quantization import Quantization

COARSE = 0.5
"""A converter is named where its step, as noise, is this share of all that is left."""
UNCERTAIN = 0.9
"""An effect less probable than this is worth another recording."""
LEAST_SAMPLES = 100
HELD_OUT = (
    "three contiguous tenths of each recording, from 25, 55 and 85 % of its length; the state carries over"
)


def diagnose(
    recordings: Sequence[Recording],
    simulation: Stage | None = None,
    *,
    say: Callable[[str], None] = lambda sentence: None,
    executor: Executor | None = None,
) -> Diagnosis:
    """Where a simulation and recordings differ, and what was left out of it.

    Args:
        recordings: One or more of the same stage, at any sample rates, first sample de-energised.
        simulation: What they are compared with; None is the plain stage: symmetric, rate-independent
            Prandtl–Ishlinskii hysteresis, everything else ideal.
        say: Called with a sentence at every step.
        executor: Where independent fits run; None is this process.

    Raises:
        RecordingError: No recordings; auxiliary columns that differ between them; a simulation in other
            units than the recordings.
    """
    check(recordings, simulation)
    records = prepare(recordings)
    chain, what = Chain(records), seen(records)
    lsb_um, lattice_note = converter(records)
    floor = noise_floor_um(records, lsb_um)
    say("nominal: the simulation as it is, then refitted with as many plays as the data carry")
    start = given_members(simulation)
    if simulation is None:
        nominal = fit(chain, Hypothesis(plain(what)))
        first = nominal.residuals
    else:
        first = simulated(simulation, records)
    search = Search(chain, say, start, floor, executor, lsb_um)
    retuned, final, history = search.run()
    floor_um = search.floor_um(final)
    say("decide: every named effect against its rivals")
    decision = decide(search, retuned, final, history, floor_um)
    if lsb_um > 0 and lsb_um / np.sqrt(12) > COARSE * final.heldout_rms:
        decision = with_converter(decision, lsb_um, final, retuned)
    modelled = augmented = unaided(chain, final, search.jump.value_um) if search.jump else final
    if decision.verdict in ("unexplained", "partly_explained") or floor is None:
        say("unknown path: what no effect explains")
        augmented = with_remainder(chain, compressed(chain, modelled)) or modelled
        if floor is None and augmented is not modelled:
            decision = with_unexplained(decision, final, augmented, retuned)
    say("model: everything refitted to all samples")
    everything = Chain(whole(recordings))
    last = fit(everything, modelled.hypothesis, modelled.weights, 4)
    if augmented is not modelled:
        last = with_remainder(everything, compressed(everything, last), judged=False) or last
    stage = augmented_stage(last, what, floor_um)
    traces = traces_of(recordings, records, retuned, augmented, final, search.chain, decision)
    say("locate: where the residual lives")
    where = locate(traces, floor_um)
    open_names = open_between(decision)
    next_one, excitation = next_recording(
        open_names, what, unexplained=decision.verdict in ("unexplained", "partly_explained")
    )
    notes = (
        *cannot_be_decided(records), *lattice_note, *conventions(final), *history_notes(search, final),
        *slip_notes(search, final, augmented), *conflict(traces, floor_um),
    )  # fmt: skip
    errors = (
        errors_of(records, first), errors_of(records, retuned.residuals),
        errors_of(records, augmented.residuals),
    )  # fmt: skip
    return Diagnosis(
        verdict=decision.verdict, effects=decision.effects, where=where,
        nominal=errors[0], retuned=errors[1], augmented=errors[2], noise_floor_um=floor_um,
        heldout=HELD_OUT, unexplained_share=decision.unexplained_share, next_recording=next_one,
        next_excitation=excitation, notes=notes, traces=traces, stage=stage,
        says=paragraph(decision, errors, floor_um, floor is not None, next_one),
    )  # fmt: skip


def check(recordings: Sequence[Recording], simulation: Stage | None) -> None:
    """Raise `RecordingError` for what no diagnosis can be made of."""
    if not recordings:
        raise RecordingError("recordings: found none, want at least one")
    columns = {tuple(sorted(recording.aux)) for recording in recordings}
    if len(columns) > 1:
        first, other = sorted(columns)[:2]
        raise RecordingError(
            f"auxiliary columns differ between the recordings: found {list(first)} and {list(other)}, "
            "want the same in all; leave out the ones that not all have"
        )
    for recording in recordings:
        name = recording.source or recording.name
        if len(recording) < LEAST_SAMPLES:
            raise RecordingError(f"{name}: found {len(recording)} samples, want at least {LEAST_SAMPLES}")
        for signal, values in {"input": recording.u, "output": recording.y, **recording.aux}.items():
            if not np.isfinite(values).all():
                row = int(np.flatnonzero(~np.isfinite(values))[0])
                raise RecordingError(
                    f"{name}: {signal} is {values[row]} at sample {row}, want finite numbers"
                )
    if all(np.ptp(recording.u) == 0 for recording in recordings):
        raise RecordingError("recordings: the input never moves, want at least one in which it does")
    if simulation is not None:
        check_units(recordings, simulation)


def check_units(recordings: Sequence[Recording], simulation: Stage) -> None:
    """A simulation that moves a hundred times more, or less, than the stage is in other units."""
    largest = max(recordings, key=lambda recording: float(np.ptp(recording.y)))
    y = simulated_output(simulation, prepare([largest])[0])
    ratio = np.ptp(y) / max(float(np.ptp(largest.y)), 1e-300)
    if not 1e-2 < ratio < 1e2:
        raise RecordingError(
            f"simulation: moves {np.ptp(y):.4g} µm where {largest.source or largest.name} moves "
            f"{np.ptp(largest.y):.4g} µm; want both in V and µm"
        )


def converter(records: Sequence[Record]) -> tuple[float, tuple[str, ...]]:
    """The step of the lattice on which all readings lie, µm, and a note; 0 where they lie on none."""
    steps = [Quantization.lattice(record.y) for record in records]
    found = [step for step in steps if step is not None]
    if len(found) < len(records) or max(found) > 1.01 * min(found):
        return 0.0, ()
    step = float(np.median(found))
    return step, (f"All readings lie on a lattice of {step * 1e3:.4g} nm.",)


def with_converter(decision: Decision, lsb_um: float, final: Fit, retuned: Fit) -> Decision:
    """The same with the sensor's converter among the effects: its lattice is seen, not fitted."""
    own = lsb_um**2 / 12
    effect = NamedEffect(
        Quantization.name, Quantization.block, (), 0.99,
        (Parameter("lsb_um", lsb_um, "µm", (lsb_um * (1 - 1e-6), lsb_um * (1 + 1e-6))),),
        min(1.0, own / max(retuned.heldout_rms**2, 1e-300)), Quantization.equation, Quantization.signature,
        (),
    )  # fmt: skip
    now_named: dict[Verdict, Verdict] = {"nothing_missing": "explained", "unexplained": "partly_explained"}
    verdict = now_named.get(decision.verdict, decision.verdict)
    return replace(decision, verdict=verdict, effects=(*decision.effects, effect))


def with_unexplained(decision: Decision, final: Fit, augmented: Fit, retuned: Fit) -> Decision:
    """The same where the noise is not known, but a remainder without a name removes some of what is left."""
    share = (final.heldout_rms**2 - augmented.heldout_rms**2) / max(retuned.heldout_rms**2, 1e-300)
    verdict: Verdict = "partly_explained" if decision.effects else "unexplained"
    return replace(decision, verdict=verdict, unexplained_share=min(1.0, share))


def errors_of(records: Sequence[Record], residuals: Sequence[np.ndarray]) -> Errors:
    """Of these residuals, train and held out."""
    held = np.concatenate([e[~r.train] for r, e in zip(records, residuals, strict=True)])
    return Errors(rms(records, residuals, True), rms(records, residuals, False), float(np.abs(held).max()))


def traces_of(
    recordings: Sequence[Recording], records: Sequence[Record], retuned: Fit, augmented: Fit, final: Fit,
    chain: Chain, decision: Decision,
) -> tuple[Trace, ...]:  # fmt: skip
    """Each recording before and after, and what each named effect adds."""
    names = {effect.name for effect in decision.effects}
    added = [name for name in dict.fromkeys(final.hypothesis.names) if name in names]
    traces = []
    for r, (recording, record) in enumerate(zip(recordings, records, strict=True)):
        full = chain.output(final.hypothesis, final.weights, r)
        signatures = {
            name: full - chain.output(final.hypothesis.without(name), final.weights, r) for name in added
        }
        traces.append(
            Trace(
                recording.name, recording.fs_hz, recording.t, record.u, record.y, ~record.train,
                retuned.residuals[r], augmented.residuals[r], signatures,
            )
        )  # fmt: skip
    return tuple(traces)


def open_between(decision: Decision) -> list[str]:
    """The names between which the choice is open, the least certain effect's first."""
    for effect in sorted(decision.effects, key=lambda effect: effect.probability):
        if effect.alternatives:
            return [effect.name, *effect.alternatives]
    return [effect.name for effect in decision.effects if effect.probability < UNCERTAIN]


def conventions(final: Fit) -> tuple[str, ...]:
    """Timing that is a convention of who recorded, not physics."""
    if final.hypothesis.alignment == 0:
        return ("y(k) answers the command of its own tick.",)
    return (
        "y(k) answers the command of the tick before: taken as the rig's convention; a delay of just one "
        "sample cannot be told from it.",
    )


def slip_notes(search: Search, told: Fit, modelled: Fit) -> tuple[str, ...]:
    """What can be foretold of a mount that sticks, and what not."""
    if search.jump is None:
        return ()
    left = "" if "stiction" in modelled.hypothesis.names else ", no better than without a mount that sticks"
    return (
        f"The mount sticks and slips. From one reading to the next it is foretold to {nm(told.heldout_rms)}; "
        f"simulated without readings to {nm(modelled.heldout_rms)}{left}, because each slip decides where "
        "the next one begins. The second is what the fit and its figures show.",
    )


def history_notes(search: Search, final: Fit) -> tuple[str, ...]:
    """What was retuned, what ended on a bound, what these recordings are too short for."""
    notes = [
        f"Retuned: {member.effect.name} {name} {before:.4g} → {member.shared[name]:.4g}."
        for given in search.start
        for member in final.hypothesis.members
        if member.effect is given.effect
        for name, before in given.shared.items()
        if abs(member.shared[name] - before) > 0.02 * abs(before)
    ]
    notes += [f"{name}: left out, {why}." for name, why in search.left_out]
    return tuple(notes)
