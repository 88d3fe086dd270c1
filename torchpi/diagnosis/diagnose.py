"""The diagnosis of recordings: locate what is missing, name and model it, and show the fit improve."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from torchpi.diagnosis.across_recordings import across_recordings
from torchpi.diagnosis.another_motion import another_motion_um
from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.clock import clock_notes
from torchpi.diagnosis.conflict import conflict
from torchpi.diagnosis.contest import FAINT
from torchpi.diagnosis.converter import converter, of_converter
from torchpi.diagnosis.coverage import cannot_be_decided, untested
from torchpi.diagnosis.decide import CLOSED, Decision, decide, if_it_carries_over
from torchpi.diagnosis.diagnosis import (
    AcrossRecordings,
    Diagnosis,
    Errors,
    NamedEffect,
    Trace,
    Verdict,
)
from torchpi.diagnosis.fit import fit, rms
from torchpi.diagnosis.hypothesis import Fit, Hypothesis
from torchpi.diagnosis.hysteresis_model import plain
from torchpi.diagnosis.leftovers import leftovers
from torchpi.diagnosis.locate import locate
from torchpi.diagnosis.long_recordings import at_a_lower_rate
from torchpi.diagnosis.model import augmented_stage
from torchpi.diagnosis.next_recording import next_recording
from torchpi.diagnosis.noise import is_white, noise_of_prediction
from torchpi.diagnosis.outside import Outside, untried_note
from torchpi.diagnosis.posterior import posterior
from torchpi.diagnosis.records import Record, not_counting, prepare, seen, without_start
from torchpi.diagnosis.reduced_basis import reduced
from torchpi.diagnosis.remainder import unless_unknown, with_remainder
from torchpi.diagnosis.say import Changed, nm, paragraph
from torchpi.diagnosis.score import Weighting
from torchpi.diagnosis.search import Search
from torchpi.diagnosis.simulation import (
    Simulation,
    given_members,
    outside,
    simulated,
    simulated_output,
    with_untried,
)
from torchpi.diagnosis.stick_slip import free_run, without_rests
from torchpi.diagnosis.timing import lateness_s
from torchpi.diagnosis.wrong_readings import of_dropouts, wrong_readings
from torchpi.errors import RecordingError
from torchpi.recordings.recording import Recording
from torchpi.stage import Stage
from torchpi.stage.effects import EFFECTS
from torchpi.stage.effects.effect import Effect
from torchpi.stage.effects.inside import InsideEffect
from torchpi.stage.identified import Identified

UNCERTAIN = 0.9
"""An effect with a lower probability than this is worth another recording."""
LEAST_SAMPLES = 100
HELD_OUT = "the last 15 % of each recording, not used in any fit until the end; the state carries over"


def diagnose(
    recordings: Sequence[Recording],
    simulation: Simulation | None = None,
    *,
    effects: Sequence[type[Effect] | type[InsideEffect]] = EFFECTS,
    log: Callable[[str], None] = lambda sentence: None,
    executor: Executor | None = None,
) -> Diagnosis:
    """Diagnose where a simulation and recordings differ, and which effects the simulation lacks.

    Args:
        recordings: One or more recordings of the same stage, at any sample rates.
        simulation: What they are compared with: a stage; any function simulate(u_v, fs_hz) -> y_um of whole
            records, without noise, from rest; "column", the `simulated` of each recording. None is the
            plain stage: symmetric, rate-independent Prandtl–Ishlinskii hysteresis, everything else ideal.
        effects: The effects that are tried as missing physics.
        log: Called with a sentence at every step.
        executor: Runs independent fits; None runs them in this process. A simulation that cannot be pickled
            is called in this process only.

    Raises:
        RecordingError: No recordings; auxiliary columns that differ between them; a simulation in other
            units than the recordings.
        SimulationError: A simulation that fails, or that does not return a displacement.
    """
    check(recordings)
    given_recordings = recordings
    out = [not_counting(each) for each in recordings]
    recordings, out, long = at_a_lower_rate(recordings, out)
    records = prepare(recordings, out, as_recorded=given_recordings)
    called = outside(simulation)
    given = simulation if isinstance(simulation, Stage) else None
    if called is not None:
        called.check(records)
        executor = executor if called.travels else None
    if (compared := called or given) is not None:
        check_units(records, compared)
    tried = [effect for effect in effects if called is None or called.can_try(effect)]
    untried = [effect for effect in effects if effect not in tried]
    what, start = seen(records), given_members(given)
    hysteresis = given.hysteresis if given is not None else None
    codes, codes_note = converter(given_recordings)
    # Averaging over ticks reduces the error of a converter, as it does any noise.
    lsb_um = codes.step_um * float(np.sqrt(np.median([one.tick_s / one.period_s for one in records])))

    def search_of(records: Sequence[Record]) -> Search:
        chain = Chain(records)
        noise = noise_of_prediction(records, lsb_um, chain.gain_um_per_v)
        return Search(chain, log, start, noise, executor, lsb_um, tried, called, hysteresis)

    log("nominal: the simulation as it is, then refitted with as many plays as the data support")
    search = search_of(records)
    retuned, final, history = search.run()
    lost = wrong_readings(records, apart(out, recordings), final)
    if count := sum(map(len, map(np.setdiff1d, lost, out))):
        log(f"wrong readings: the residual shows {count} more; the search starts again without them")
        out = [np.union1d(one, more).astype(int) for one, more in zip(out, lost, strict=True)]
        records = prepare(recordings, out, as_recorded=given_recordings)
        search = search_of(records)
        retuned, final, history = search.run()
    first = (
        fit(Chain(records), Hypothesis(plain(what))).residuals
        if compared is None
        else simulated(compared, records)
    )
    search.noise = search.noise_left(final)
    log("decide: every effect against its rivals")
    final, believed = posterior(search, retuned, final, history)
    final, believed = unless_unknown(search, retuned, final, believed)
    noise = search.noise_left(final)
    believed = believed if called is None else with_untried(believed, tried, untried)
    chain = without_rests(search.chain) if search.slips else search.chain
    records = list(chain.records)
    modelled = augmented = free_run(chain, final, search.jump.value_um) if search.jump else final
    log("remainder: what no effect explains")
    remainder = with_remainder(chain, reduced(chain, modelled))
    if remainder is not None:
        augmented = remainder[0]
    left = [e[r.train] for e, r in zip(augmented.residuals, records, strict=True)]
    loud = leftovers(records, augmented.residuals)
    structured = remainder is not None or not all(map(is_white, left))
    decision = decide(search, retuned, final, believed, noise, structured, bool(loud))
    loudest_um = final.train_rms if noise is None else min(noise.rms_um, final.train_rms)
    if lsb_um > 0 and lsb_um / np.sqrt(12) > FAINT * loudest_um:
        decision = with_read_off(decision, of_converter(codes, lsb_um, retuned))
    lost = wrong_readings(records, apart(out, recordings), final)
    if any(len(each) for each in lost):
        decision = with_read_off(decision, of_dropouts(records, lost, final))
    alike = untested(records, what)
    across: tuple[AcrossRecordings, ...] = ()
    another_um: float | None = None
    if decision.verdict in CLOSED:
        log("other motions: whether the recordings predict one another, and determine the hysteresis")
        if not search.slips:
            across = across_recordings(search.chain, final)
        another_um = another_motion_um(chain, modelled.hypothesis)
        left_um = noise.rms_um if noise is not None else final.train_rms
        too_alike = bool(alike) and search.has_larger(final)
        decision = if_it_carries_over(decision, across, another_um, left_um, too_alike)
    log("model: everything refitted to all samples")
    complete = without_start(
        prepare(recordings, out, as_recorded=given_recordings, sealed=0.0), search.unsettled
    )
    everything = Chain(complete, Weighting.of(complete, modelled.residuals, noise))
    # Each slip of a sticking mount decides where the next one begins: there is no gradient to follow.
    last = modelled if search.jump else fit(everything, modelled.hypothesis, modelled.weights, 4)
    if remainder is not None:
        again = with_remainder(everything, reduced(everything, last), remainder[1])
        last = again[0] if again else last
    floor_um = noise.rms_um if noise is not None else 0.0
    # The stage runs at the controller's sample rate, even where the records are means over ticks.
    at_ticks = replace(what, fs_hz=max(1 / record.tick_s for record in records))
    if not (search.added(final) or search.has_larger(final) or search.slips):
        retuned = final  # nothing was added, so the search has only retuned further
    stage = augmented_stage(last, len(recordings), at_ticks, floor_um or augmented.heldout_rms)
    traces = traces_of(recordings, records, retuned, augmented, final, search.chain, decision)
    log("locate: where the residual lives")
    where = locate(from_settled(traces, search.unsettled), floor_um)
    next_one, excitation = next_recording(
        open_between(decision),
        what,
        determined=decision.carries_over,
        unexplained=decision.verdict not in CLOSED,
    )
    notes = (
        *long,
        *cannot_be_decided(records),
        *untried_note(called, untried),
        *codes_note,
        *monitored_notes(records),
        *start_notes(records, search.unsettled),
        *clock_notes(search, final),
        *conventions(search, final),
        *history_notes(search, final),
        *slip_notes(search, final, augmented),
        *conflict(traces, floor_um),
    )
    errors = (
        errors_of(records, first),
        errors_of(records, retuned.residuals),
        errors_of(records, augmented.residuals),
    )
    last_errors = errors[-1]
    stage.identified = Identified.of(
        given_recordings, HELD_OUT, last_errors.heldout_rms_um, last_errors.heldout_max_um
    )
    return Diagnosis(
        verdict=decision.verdict, effects=decision.effects, open=decision.causes_left_open, where=where,
        nominal=errors[0], retuned=errors[1], augmented=errors[2],
        across=across, another_motion_um=another_um, carries_over=decision.carries_over,
        noise_floor_um=noise.rms_um if noise is not None else None,
        heldout=HELD_OUT, unexplained_share=decision.unexplained_share, joint_share=decision.joint_share,
        next_recording=next_one, next_excitation=excitation, notes=notes, traces=traces, stage=stage,
        says=paragraph(
            decision, errors, noise, next_one, loud, alike, across, another_um, changed(search, final)
        ),
    )  # fmt: skip


def check(recordings: Sequence[Recording]) -> None:
    """Raise `RecordingError` for recordings that cannot be diagnosed."""
    if not recordings:
        raise RecordingError("recordings: found none, expected at least one")
    columns = {tuple(sorted(recording.aux)) for recording in recordings}
    if len(columns) > 1:
        first, other = sorted(columns)[:2]
        raise RecordingError(
            f"auxiliary columns differ between the recordings: found {list(first)} and {list(other)}, "
            "expected the same in all; leave out those that some recordings lack"
        )
    for recording in recordings:
        name = recording.source or recording.name
        if len(recording) < LEAST_SAMPLES:
            raise RecordingError(f"{name}: found {len(recording)} samples, expected at least {LEAST_SAMPLES}")
        for signal, values in {"input": recording.u, "output": recording.y, **recording.aux}.items():
            if not np.isfinite(values).all():
                row = int(np.flatnonzero(~np.isfinite(values))[0])
                raise RecordingError(
                    f"{name}: {signal} is {values[row]} at sample {row}, expected finite numbers"
                )
    if all(np.ptp(recording.u) == 0 for recording in recordings):
        raise RecordingError("recordings: the input never changes, expected at least one in which it does")


def check_units(records: Sequence[Record], simulation: Stage | Outside) -> None:
    """Raise `RecordingError` if a simulation moves a hundred times more or less: its units are wrong."""
    largest = max(records, key=lambda record: float(np.ptp(record.y)))
    y = simulated_output(simulation, largest)
    ratio = np.ptp(y) / max(float(np.ptp(largest.y)), 1e-300)
    if not 1e-2 < ratio < 1e2:
        raise RecordingError(
            f"simulation: it moves {np.ptp(y):.4g} µm where {largest.name} moves {np.ptp(largest.y):.4g} "
            "µm; expected both in V and µm"
        )


def apart(out: Sequence[np.ndarray], recordings: Sequence[Recording]) -> list[np.ndarray]:
    """Return the readings that do not count, (readings,) of each recording, without those never taken."""
    return [np.setdiff1d(each, one.not_read) for each, one in zip(out, recordings, strict=True)]


def with_read_off(decision: Decision, effect: NamedEffect) -> Decision:
    """Add an effect that is read off the readings, not fitted; other shares are scaled to what it leaves."""
    now_named: dict[Verdict, Verdict] = {"nothing_missing": "explained", "unexplained": "partly_explained"}
    rest = 1.0 - effect.share
    others = [replace(other, share=rest * other.share) for other in decision.effects]
    return replace(
        decision,
        verdict=now_named.get(decision.verdict, decision.verdict),
        effects=(*others, effect),
        unexplained_share=rest * decision.unexplained_share,
        joint_share=rest * decision.joint_share,
    )


def errors_of(records: Sequence[Record], residuals: Sequence[np.ndarray]) -> Errors:
    """Errors of these residuals, on training and held-out samples."""
    held = np.concatenate([e[r.held_out] for r, e in zip(records, residuals, strict=True)])
    return Errors(rms(records, residuals, True), rms(records, residuals, False), float(np.abs(held).max()))


def traces_of(
    recordings: Sequence[Recording],
    records: Sequence[Record],
    retuned: Fit,
    augmented: Fit,
    final: Fit,
    chain: Chain,
    decision: Decision,
) -> tuple[Trace, ...]:
    """Each recording with its residuals before and after, and what each named effect adds."""
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
                recording.name,
                recording.fs_hz,
                recording.t,
                record.u,
                record.y,
                np.arange(len(record.u)) >= record.coefficients.samples,
                retuned.residuals[r],
                augmented.residuals[r],
                signatures,
            )
        )
    return tuple(traces)


def from_settled(traces: Sequence[Trace], unsettled: Sequence[int]) -> list[Trace]:
    """The traces with a residual of 0 in readings at the start that do not count."""
    return [
        replace(one, residual_retuned=np.where(np.arange(len(one.t)) < first, 0.0, one.residual_retuned))
        for one, first in zip(traces, unsettled, strict=True)
    ]


def open_between(decision: Decision) -> list[str]:
    """The names between which the choice is open: of the least certain effect with alternatives, if any."""
    for effect in sorted(decision.effects, key=lambda effect: effect.probability):
        if effect.alternatives:
            return [effect.name, *effect.alternatives]
    uncertain = [effect.name for effect in decision.effects if effect.probability < UNCERTAIN]
    return uncertain or [one.name for one in decision.causes_left_open[:1]]


def monitored_notes(records: Sequence[Record]) -> tuple[str, ...]:
    """A sentence on the noise of each voltage that was monitored rather than commanded."""
    noisy = [f"{r.monitor_noise_v:.2g} V in {r.name}" for r in records if r.monitor_noise_v]
    return (
        (
            "The measured voltage contains noise, which is removed before the voltage drives the model: "
            f"{', '.join(noisy)}.",
        )
        if noisy
        else ()
    )


def start_notes(records: Sequence[Record], unsettled: Sequence[int]) -> tuple[str, ...]:
    """A sentence for each recording whose start does not count."""
    return tuple(
        f"{record.name}: the first {first} readings, {1e3 * first / record.fs_hz:.3g} ms, do not count: "
        "the stage was still settling after a motion before the recording."
        for record, first in zip(records, unsettled, strict=True)
        if first
    )


def conventions(search: Search, final: Fit) -> tuple[str, ...]:
    """Sentences on timing: the convention of the rig, which is not physics, and the total lateness."""
    if any(m.effect.delays and m.effect.name not in search.given for m in final.hypothesis.members):
        ms = 1e3 * lateness_s(search.chain, final.hypothesis)
        text = (
            f"In total, the readings lag a slow command by {ms:.3g} ms: the sum of all lags and delays of "
            "the model."
        )
        return (*convention(final), text)
    return convention(final)


def convention(final: Fit) -> tuple[str, ...]:
    """A sentence that says which tick's command y(k) answers."""
    if final.hypothesis.alignment < 0:
        return (
            "The simulation responds one sample later than y(k), which is taken as its timing convention: "
            "its output for u(k+1) is compared with y(k).",
        )
    if final.hypothesis.alignment == 0:
        return ("y(k) responds to the command of the same tick.",)
    return (
        "y(k) responds to the command of the previous tick, which is taken as the rig's timing "
        "convention; a delay of exactly one sample cannot be told from it.",
    )


def slip_notes(search: Search, one_step: Fit, modelled: Fit) -> tuple[str, ...]:
    """A sentence on what can be predicted of a mount that sticks, and what cannot."""
    if search.jump is None:
        return ()
    left = "" if "stiction" in modelled.hypothesis.names else ", no better than without stick-slip"
    return (
        "The mount shows stick-slip. Its one-step-ahead prediction has an error of "
        f"{nm(one_step.heldout_rms)} rms, its free-run simulation one of {nm(modelled.heldout_rms)} "
        f"rms{left}, because each slip decides where the next one begins. The report shows the free-run "
        "error.",
    )


def changed(search: Search, final: Fit) -> list[Changed]:
    """Return the parameters of the given stage that retuning changed, the most changed first."""
    found = [
        Changed(member.effect.name, name, member.effect.quantities[name].unit, before, member.shared[name])
        for given in search.start
        for member in final.hypothesis.members
        if member.effect is given.effect
        for name, before in given.shared.items()
        if name in member.shared and abs(member.shared[name] - before) > 0.02 * abs(before)
    ]

    def relative(one: Changed) -> float:
        return abs(one.after - one.before) / max(min(abs(one.after), abs(one.before)), 1e-300)

    return sorted(found, key=relative, reverse=True)


def history_notes(search: Search, final: Fit) -> tuple[str, ...]:
    """Sentences on what was retuned, and on candidates that these recordings cannot show."""
    notes = [
        f"Retuned: {one.effect} {one.name} {one.before:.4g} → {one.after:.4g}."
        for one in changed(search, final)
    ]
    notes += [f"{name}: left out, {why}." for name, why in search.left_out]
    return tuple(notes)
