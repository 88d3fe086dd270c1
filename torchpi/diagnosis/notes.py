"""Sentences on what a diagnosis assumed, left out or changed, for the report."""

from collections.abc import Sequence

from torchpi.diagnosis.clock import clock_notes
from torchpi.diagnosis.conflict import conflict
from torchpi.diagnosis.diagnosis import Trace
from torchpi.diagnosis.hypothesis import Fit
from torchpi.diagnosis.records import Record
from torchpi.diagnosis.say import Changed, nm
from torchpi.diagnosis.search import Search
from torchpi.diagnosis.timing import lateness_s


def notes(
    search: Search,
    records: Sequence[Record],
    final: Fit,
    modelled: Fit,
    traces: Sequence[Trace],
    floor_um: float,
) -> tuple[str, ...]:
    """Return the sentences in the order of the report.

    Args:
        search: The finished search.
        records: Its recordings.
        final: The best fit; of a mount that sticks, its one-step-ahead prediction.
        modelled: The fit whose errors are reported.
        traces: Each recording with its residuals.
        floor_um: The noise of a reading, if it was measured; else 0.
    """
    return (
        *monitored_notes(records),
        *start_notes(records, search.unsettled),
        *clock_notes(search, final),
        *conventions(search, final),
        *history_notes(search, final),
        *slip_notes(search, final, modelled),
        *conflict(traces, floor_um),
    )


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
