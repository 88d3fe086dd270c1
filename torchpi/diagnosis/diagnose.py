"""The diagnosis of recordings: locate what is missing, name and model it, and show the fit improve."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from torchpi.diagnosis.across_recordings import across_recordings
from torchpi.diagnosis.another_motion import another_motion_um
from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.clock import seen_early
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
from torchpi.diagnosis.model import augmented_stage
from torchpi.diagnosis.next_recording import next_recording
from torchpi.diagnosis.noise import Noise, is_white, noise_of_prediction
from torchpi.diagnosis.notes import changed, notes
from torchpi.diagnosis.outside import Outside, untried_note
from torchpi.diagnosis.posterior import posterior
from torchpi.diagnosis.readings import Readings
from torchpi.diagnosis.records import Record, seen, without_start
from torchpi.diagnosis.reduced_basis import reduced
from torchpi.diagnosis.remainder import unless_unknown, with_remainder
from torchpi.diagnosis.say import paragraph
from torchpi.diagnosis.score import Weighting
from torchpi.diagnosis.search import Round, Search
from torchpi.diagnosis.simulation import (
    Simulation,
    given_members,
    outside,
    simulated,
    simulated_output,
    with_untried,
)
from torchpi.diagnosis.stick_slip import free_run, without_rests
from torchpi.diagnosis.wandering import Wandering, with_wandering
from torchpi.diagnosis.wrong_readings import of_dropouts
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
    readings = Readings.of(recordings)
    records = readings.records()
    what = seen(records)
    called = outside(simulation)
    given = simulation if isinstance(simulation, Stage) else None
    if called is not None:
        called.check(records)
        executor = executor if called.travels else None
    if (compared := called or given) is not None:
        check_units(records, compared)
    tried = [effect for effect in effects if called is None or called.can_try(effect)]
    untried = [effect for effect in effects if effect not in tried]
    codes, codes_note = converter(recordings)
    # Averaging over ticks reduces the error of a converter, as it does any noise.
    lsb_um = codes.step_um * float(np.sqrt(np.median([one.tick_s / one.period_s for one in records])))

    def search_of(records: Sequence[Record]) -> Search:
        chain = Chain(records)
        noise = noise_of_prediction(records, lsb_um, chain.gain_um_per_v)
        start, hysteresis = given_members(given), given.hysteresis if given is not None else None
        return Search(chain, log, start, noise, executor, lsb_um, tried, called, hysteresis)

    log("nominal: the simulation as it is, then refitted with as many plays as the data support")
    readings, search, retuned, final, history = searched(readings, records, search_of, log)
    log("decide: every effect against its rivals")
    final, believed = posterior(search, retuned, final, history)
    final, believed = unless_unknown(search, retuned, final, believed)
    noise = search.noise_left(final)
    believed = believed if called is None else with_untried(believed, tried, untried)
    chain = without_rests(search.chain) if search.slips else search.chain
    modelled = free_run(chain, final, search.jump.value_um) if search.jump else final
    log("remainder: what no effect explains")
    remainder = with_remainder(chain, reduced(chain, modelled))
    augmented = remainder[0] if remainder else modelled
    loud = leftovers(chain.records, augmented.residuals)
    left = [e[r.train] for e, r in zip(augmented.residuals, chain.records, strict=True)]
    structured = remainder is not None or not all(map(is_white, left))
    decision = decide(search, retuned, final, believed, noise, structured, bool(loud))
    loudest_um = final.train_rms if noise is None else min(noise.rms_um, final.train_rms)
    if lsb_um > 0 and lsb_um / np.sqrt(12) > FAINT * loudest_um:
        decision = with_read_off(decision, of_converter(codes, lsb_um, retuned))
    wrong = readings.wrong(chain.records, final)
    if any(map(len, wrong)):
        decision = with_read_off(decision, of_dropouts(chain.records, wrong, final))
    wanders: Wandering | None = None
    if decision.verdict not in CLOSED and not search.slips:
        log("wandering: whether what is left is a slow signal of its own")
        decision, wanders = with_wandering(decision, chain.records, retuned, final, noise, tried)
    alike = untested(chain.records, what)
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
    whole = on_all_samples(readings, search, modelled, noise, remainder[1] if remainder else None)
    floor_um = noise.rms_um if noise is not None else 0.0
    # The stage runs at the controller's sample rate, even where the records are means over ticks.
    at_ticks = replace(what, fs_hz=max(1 / record.tick_s for record in chain.records))
    stage = augmented_stage(whole, len(recordings), at_ticks, floor_um or augmented.heldout_rms)
    if compared is None:
        first = fit(Chain(chain.records), Hypothesis(plain(what))).residuals
    else:
        first = simulated(compared, chain.records)
    if not (search.added(final) or search.has_larger(final) or search.slips):
        retuned = final  # nothing was added, so the search has only retuned further
    errors = (
        errors_of(chain.records, first),
        errors_of(chain.records, retuned.residuals),
        errors_of(chain.records, augmented.residuals),
    )
    stage.identified = Identified.of(recordings, HELD_OUT, errors[2].heldout_rms_um, errors[2].heldout_max_um)
    traces = traces_of(readings.recordings, chain.records, retuned, augmented, final, search.chain, decision)
    traces = with_added(traces, wanders) if wanders else traces
    log("locate: where the residual lives")
    where = locate(from_settled(traces, search.unsettled), floor_um)
    next_one, excitation = next_recording(
        open_between(decision),
        what,
        determined=decision.carries_over,
        unexplained=decision.verdict not in CLOSED,
    )
    return Diagnosis(
        verdict=decision.verdict, effects=decision.effects, open=decision.causes_left_open, where=where,
        nominal=errors[0], retuned=errors[1], augmented=errors[2],
        across=across, another_motion_um=another_um, carries_over=decision.carries_over,
        noise_floor_um=noise.rms_um if noise is not None else None,
        heldout=HELD_OUT, unexplained_share=decision.unexplained_share, joint_share=decision.joint_share,
        next_recording=next_one, next_excitation=excitation,
        notes=(
            *readings.notes, *readings.masked(wrong), *cannot_be_decided(chain.records),
            *untried_note(called, untried), *codes_note,
            *notes(search, chain.records, final, augmented, traces, floor_um),
        ),
        traces=traces, stage=stage,
        says=paragraph(
            decision, errors, noise, next_one, loud, alike, across, another_um, changed(search, final)
        ),
    )  # fmt: skip


def searched(
    readings: Readings,
    records: Sequence[Record],
    search_of: Callable[[Sequence[Record]], Search],
    log: Callable[[str], None],
) -> tuple[Readings, Search, Fit, Fit, list[Round]]:
    """Search, and once more if the residual shows wrong readings; return the readings that count, the search
    and what it found. Readings of a jittering clock are first brought back to their ticks."""
    early_by = 0.0
    if any(record.late_s is not None for record in records):
        share = seen_early(records, search_of(records).retuned().residuals)
        if share is not None:
            readings, early_by = readings.at_their_ticks(share), max(float(one.max()) for one in share)
            log(f"clock: late readings have seen up to {100 * early_by:.2g} % of the next step")
            records = readings.records()
    search = search_of(records)
    search.brought_back = early_by
    found = search.run()
    wrong = readings.wrong(records, found[1])
    if count := sum(map(len, map(np.setdiff1d, wrong, readings.out))):
        log(f"wrong readings: the residual shows {count} more; the search starts again without them")
        readings = readings.without(wrong)
        search = search_of(readings.records())
        search.brought_back = early_by
        found = search.run()
    search.noise = search.noise_left(found[1])
    return readings, search, *found


def on_all_samples(
    readings: Readings, search: Search, modelled: Fit, noise: Noise | None, ridge: float | None
) -> Fit:
    """Refit to all samples, the sealed ones as well, with an unknown remainder if there is a `ridge`."""
    complete = without_start(readings.records(sealed=0.0), search.unsettled)
    chain = Chain(complete, Weighting.of(complete, modelled.residuals, noise))
    # Each slip of a sticking mount decides where the next one begins: there is no gradient to follow.
    last = modelled if search.jump else fit(chain, modelled.hypothesis, modelled.weights, 4)
    again = None if ridge is None else with_remainder(chain, reduced(chain, last), ridge)
    return again[0] if again else last


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


def with_added(traces: Sequence[Trace], wanders: Wandering) -> tuple[Trace, ...]:
    """The traces with what a wandering gain or zero adds to each."""
    return tuple(
        replace(trace, signatures={**trace.signatures, wanders.effect.name: adds_um})
        for trace, adds_um in zip(traces, wanders.adds, strict=True)
    )


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
