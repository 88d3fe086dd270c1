"""Recordings in, a diagnosis out: locate, name, model, and show the fit improve."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from torchpi.diagnosis.across_recordings import across_recordings
from torchpi.diagnosis.chain import Chain
from torchpi.diagnosis.conflict import conflict
from torchpi.diagnosis.contest import FAINT
from torchpi.diagnosis.coverage import cannot_be_decided, untested
from torchpi.diagnosis.decide import CLOSED, Decision, decide, if_it_carries_over, structure
from torchpi.diagnosis.diagnosis import (
    AcrossRecordings,
    Diagnosis,
    Errors,
    NamedEffect,
    Parameter,
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
from torchpi.diagnosis.noise import noise_of_prediction
from torchpi.diagnosis.outside import Outside, untried_note
from torchpi.diagnosis.posterior import posterior
from torchpi.diagnosis.records import Record, not_counting, prepare, seen, without_start
from torchpi.diagnosis.reduced_basis import reduced
from torchpi.diagnosis.remainder import unless_unknown, with_remainder
from torchpi.diagnosis.say import nm, paragraph
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
from torchpi.diagnosis.wrong_readings import READ_OFF, of_dropouts, wrong_readings
from torchpi.errors import RecordingError
from torchpi.recordings.recording import Recording
from torchpi.stage import Stage
from torchpi.stage.effects import EFFECTS
from torchpi.stage.effects.effect import Effect
from torchpi.stage.effects.inside import InsideEffect
from torchpi.stage.effects.sensor.quantization import EVEN, WIDEST, Quantization, uneven_codes
from torchpi.stage.identified import Identified

UNCERTAIN = 0.9
"""An effect less probable than this is worth another recording."""
LEAST_SAMPLES = 100
HELD_OUT = "the last 15 % of each recording, sealed until the end; the state carries over"


def diagnose(
    recordings: Sequence[Recording],
    simulation: Simulation | None = None,
    *,
    effects: Sequence[type[Effect] | type[InsideEffect]] = EFFECTS,
    log: Callable[[str], None] = lambda sentence: None,
    executor: Executor | None = None,
) -> Diagnosis:
    """Where a simulation and recordings differ, and what was left out of it.

    Args:
        recordings: One or more of the same stage, at any sample rates.
        simulation: What they are compared with: a stage; any function simulate(u_v, fs_hz) -> y_um of whole
            records, without noise, from rest; "column", the `simulated` of each recording. None is the
            plain stage: symmetric, rate-independent Prandtl–Ishlinskii hysteresis, everything else ideal.
        effects: What may be missing: the effects that are tried.
        log: Called with a sentence at every step.
        executor: Where independent fits run; None is this process, which alone calls a simulation that
            cannot be pickled.

    Raises:
        RecordingError: No recordings; auxiliary columns that differ between them; a simulation in other
            units than the recordings.
        SimulationError: A simulation that fails, or returns what is no displacement.
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
    chain, what = Chain(records), seen(records)
    step_um, lattice_note = converter(given_recordings)
    # Of a mean, one converter errs less, as any noise does.
    lsb_um = step_um * float(np.sqrt(np.median([one.tick_s / one.period_s for one in records])))
    noise = noise_of_prediction(records, lsb_um, chain.gain_um_per_v)
    log("nominal: the simulation as it is, then refitted with as many plays as the data carry")
    start = given_members(given)
    first = (
        fit(chain, Hypothesis(plain(what))).residuals if compared is None else simulated(compared, records)
    )
    search = Search(chain, log, start, noise, executor, lsb_um, tried, called)
    retuned, final, history = search.run()
    search.noise = search.noise_left(final)
    log("decide: every effect against its rivals")
    final, believed = posterior(search, retuned, final, history)
    final, believed = unless_unknown(search, retuned, final, believed)
    noise = search.noise_left(final)
    believed = believed if called is None else with_untried(believed, tried, untried)
    chain = without_rests(search.chain) if search.slips else search.chain
    records = list(chain.records)
    modelled = augmented = free_run(chain, final, search.jump.value_um) if search.jump else final
    log("what no effect explains")
    remainder = with_remainder(chain, reduced(chain, modelled))
    if remainder is not None:
        augmented = remainder[0]
    left = [e[r.train] for e, r in zip(augmented.residuals, records, strict=True)]
    loud = leftovers(records, augmented.residuals)
    structured = remainder is not None or structure(left)
    decision = decide(search, retuned, final, believed, noise, structured, bool(loud))
    loudest_um = final.train_rms if noise is None else min(noise.rms_um, final.train_rms)
    if lsb_um > 0 and lsb_um / np.sqrt(12) > FAINT * loudest_um:
        decision = with_read_off(decision, of_converter(step_um, lsb_um, retuned))
    wrong = [np.setdiff1d(each, one.not_read) for each, one in zip(out, recordings, strict=True)]
    lost = wrong_readings(records, wrong, final)
    if any(len(each) for each in lost):
        decision = with_read_off(decision, of_dropouts(records, lost, final))
    across: tuple[AcrossRecordings, ...] = ()
    if decision.verdict in CLOSED and not search.slips:
        log("whether the recordings predict one another")
        across = across_recordings(search.chain, final)
        decision = if_it_carries_over(decision, across)
    log("model: everything refitted to all samples")
    complete = without_start(
        prepare(recordings, out, as_recorded=given_recordings, sealed=0.0), search.unsettled
    )
    everything = Chain(complete, Weighting.of(complete, modelled.residuals, noise))
    # A mount that sticks decides at each slip where the next one begins: no gradient leads through that.
    last = modelled if search.jump else fit(everything, modelled.hypothesis, modelled.weights, 4)
    if remainder is not None:
        again = with_remainder(everything, reduced(everything, last), remainder[1])
        last = again[0] if again else last
    floor_um = noise.rms_um if noise is not None else 0.0
    # A sample of the stage is one of the controller's, where the records are means too.
    at_ticks = replace(what, fs_hz=max(1 / record.tick_s for record in records))
    stage = augmented_stage(last, len(recordings), at_ticks, floor_um or augmented.heldout_rms)
    traces = traces_of(recordings, records, retuned, augmented, final, search.chain, decision)
    log("locate: where the residual lives")
    where = locate(from_settled(traces, search.unsettled), floor_um)
    next_one, excitation = next_recording(
        open_between(decision),
        what,
        determined=all(one.predicted for one in across),
        unexplained=decision.verdict not in CLOSED,
    )
    notes = (
        *long,
        *cannot_be_decided(records),
        *untried_note(called, untried),
        *lattice_note,
        *monitored_notes(records),
        *start_notes(records, search.unsettled),
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
        across=across, noise_floor_um=noise.rms_um if noise is not None else None,
        heldout=HELD_OUT, unexplained_share=decision.unexplained_share, joint_share=decision.joint_share,
        next_recording=next_one, next_excitation=excitation, notes=notes, traces=traces, stage=stage,
        says=paragraph(decision, errors, noise, next_one, loud, untested(records, what), across),
    )  # fmt: skip


def check(recordings: Sequence[Recording]) -> None:
    """Raise `RecordingError` for what no diagnosis can be made of."""
    if not recordings:
        raise RecordingError("recordings: found none, expected at least one")
    columns = {tuple(sorted(recording.aux)) for recording in recordings}
    if len(columns) > 1:
        first, other = sorted(columns)[:2]
        raise RecordingError(
            f"auxiliary columns differ between the recordings: found {list(first)} and {list(other)}, "
            "expected the same in all; leave out the ones that not all have"
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
        raise RecordingError("recordings: the input never moves, expected at least one in which it does")


def check_units(records: Sequence[Record], simulation: Stage | Outside) -> None:
    """A simulation that moves a hundred times more, or less, than the stage is in other units."""
    largest = max(records, key=lambda record: float(np.ptp(record.y)))
    y = simulated_output(simulation, largest)
    ratio = np.ptp(y) / max(float(np.ptp(largest.y)), 1e-300)
    if not 1e-2 < ratio < 1e2:
        raise RecordingError(
            f"simulation: moves {np.ptp(y):.4g} µm where {largest.name} moves {np.ptp(largest.y):.4g} µm; "
            "expected both in V and µm"
        )


def converter(recordings: Sequence[Recording]) -> tuple[float, tuple[str, ...]]:
    """The step of the values on which all readings lie, µm, and a note; 0 where they lie on none."""
    even = [Quantization.lattice(recording.readings) for recording in recordings]
    # One converter has the same values in all recordings, a few of which a stair alone passes.
    each = [(one.readings, one.u) for one in recordings]
    y, u = map(np.concatenate, zip(*each, strict=True))
    if step := agreed(even, EVEN) or Quantization.lattice(y):
        return step, (f"All readings lie on a lattice of {step * 1e3:.4g} nm.",)
    if step := uneven_codes(y, u) or agreed([uneven_codes(*one) for one in each], WIDEST):
        return step, (f"All readings lie on few values, unevenly spaced, {step * 1e3:.4g} nm on the median.",)
    return 0.0, ()


def agreed(steps: Sequence[float | None], ratio: float) -> float:
    """The median step of all recordings; 0 where one has none, or they differ by more than a ratio."""
    found = [step for step in steps if step is not None]
    return float(np.median(found)) if len(found) == len(steps) and max(found) <= ratio * min(found) else 0.0


def with_read_off(decision: Decision, effect: NamedEffect) -> Decision:
    """The same with an effect that the readings show, and no fit: the other shares are of what it leaves."""
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


def of_converter(step_um: float, lsb_um: float, retuned: Fit) -> NamedEffect:
    """The sensor's converter: its lattice is seen. Its error is that of a step of `lsb_um`."""
    return NamedEffect(
        Quantization.name,
        Quantization.block,
        (),
        READ_OFF,
        (Parameter("lsb_um", step_um, "µm", (step_um * (1 - 1e-6), step_um * (1 + 1e-6))),),
        min(1.0, lsb_um**2 / 12 / max(retuned.train_rms**2, 1e-300)),
        Quantization.equation,
        Quantization.signature,
        (),
    )


def errors_of(records: Sequence[Record], residuals: Sequence[np.ndarray]) -> Errors:
    """Of these residuals, train and held out."""
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
    """The traces with nothing left in readings that do not count."""
    return [
        replace(one, residual_retuned=np.where(np.arange(len(one.t)) < first, 0.0, one.residual_retuned))
        for one, first in zip(traces, unsettled, strict=True)
    ]


def open_between(decision: Decision) -> list[str]:
    """The names between which the choice is open, the least certain effect's first."""
    for effect in sorted(decision.effects, key=lambda effect: effect.probability):
        if effect.alternatives:
            return [effect.name, *effect.alternatives]
    uncertain = [effect.name for effect in decision.effects if effect.probability < UNCERTAIN]
    return uncertain or [one.name for one in decision.causes_left_open[:1]]


def monitored_notes(records: Sequence[Record]) -> tuple[str, ...]:
    """The noise of each voltage that was monitored and not commanded."""
    noisy = [f"{r.monitor_noise_v:.2g} V in {r.name}" for r in records if r.monitor_noise_v]
    return (
        (f"The voltage has noise of its own, taken out before it drives: {', '.join(noisy)}.",)
        if noisy
        else ()
    )


def start_notes(records: Sequence[Record], unsettled: Sequence[int]) -> tuple[str, ...]:
    """A sentence for each recording whose start does not count."""
    return tuple(
        f"{record.name}: the first {first} readings, {1e3 * first / record.fs_hz:.3g} ms, do not count: the "
        "stage was still settling from what came before the recording."
        for record, first in zip(records, unsettled, strict=True)
        if first
    )


def conventions(search: Search, final: Fit) -> tuple[str, ...]:
    """Timing that is a convention of who recorded, not physics; and how late the readings are in all."""
    if any(m.effect.delays and m.effect.name not in search.given for m in final.hypothesis.members):
        ms = 1e3 * lateness_s(search.chain, final.hypothesis)
        text = (
            f"In all, the readings come {ms:.3g} ms behind a slow command: every lag and delay of the model."
        )
        return (*convention(final), text)
    return convention(final)


def convention(final: Fit) -> tuple[str, ...]:
    """Whose command y(k) answers."""
    if final.hypothesis.alignment < 0:
        return (
            "The simulation answers a sample later than y(k), taken as its convention: what it makes of "
            "u(k+1) is compared with y(k).",
        )
    if final.hypothesis.alignment == 0:
        return ("y(k) answers the command of its own tick.",)
    return (
        "y(k) answers the command of the tick before: taken as the rig's convention; a delay of just one "
        "sample cannot be told from it.",
    )


def slip_notes(search: Search, one_step: Fit, modelled: Fit) -> tuple[str, ...]:
    """What can be predicted of a mount that sticks, and what not."""
    if search.jump is None:
        return ()
    left = "" if "stiction" in modelled.hypothesis.names else ", no better than without a mount that sticks"
    return (
        "The mount sticks and slips. From one reading to the next it is predicted to within "
        f"{nm(one_step.heldout_rms)}; in free-run simulation to within {nm(modelled.heldout_rms)}{left}, "
        "because each slip decides where the next one begins. The second is what the fit shows.",
    )


def history_notes(search: Search, final: Fit) -> tuple[str, ...]:
    """What was retuned, what ended on a bound, what these recordings cannot show."""
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
