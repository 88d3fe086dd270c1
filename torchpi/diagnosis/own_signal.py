"""Signals that an effect brings in and neither the voltage nor the clock has: a second input, or a line."""

from collections.abc import Sequence

import numpy as np

from torchpi.diagnosis.hypothesis import Fit, Hypothesis
from torchpi.diagnosis.lines import STANDS_OUT, above_surroundings
from torchpi.diagnosis.noise import bridged
from torchpi.diagnosis.records import Record
from torchpi.diagnosis.search import Search
from torchpi.stage.effects.added_signal import AddedSignal

HARMONICS = 3
"""Of a line, that may stand out."""
PREDICTED = 0.5
"""Of the variance of a recorded signal, what the voltage may predict of it for it to be one of its own."""


def has_a_signal_of_its_own(records: Sequence[Record], h: Hypothesis, name: str) -> bool:
    """Whether an effect brings in what neither the voltage nor the clock has: a second input, or a line."""
    for member in h.members:
        if member.effect.name == name:
            # What moves a gain goes with the displacement, as any error of the model does.
            line_hz = member.effect.added_line_hz(member.values(0))
            if line_hz is not None and not any(has_line(record, line_hz) for record in records):
                return True
            if member.effect.takes_aux:
                return True
    return False


def has_a_recorded_signal(search: Search, final: Fit, name: str) -> bool:
    """Whether an effect brings in a recorded signal that the voltage does not predict: whatever else the
    model has wrong follows the voltage, and does not look like it."""
    chain, h = search.chain, final.hypothesis
    signals = {m.aux for m in h.members if m.effect.name == name and m.effect.takes_aux}
    for signal in signals:
        predicted = whole = 0.0
        for i, record in enumerate(chain.records):
            aux = record.aux[signal][record.train]
            aux = aux - aux.mean()
            rows = chain.rows(h, i)[:, record.train]
            rows = np.concatenate([rows, np.gradient(record.commanded(0))[None, record.train]])
            rows = rows - rows.mean(1, keepdims=True)
            weights = np.linalg.lstsq(rows.T, aux, rcond=1e-6)[0]
            predicted += float(((weights @ rows) ** 2).sum())
            whole += float(aux @ aux)
        if predicted > PREDICTED * whole:
            return False
    return bool(signals)


def stands_out(records: Sequence[Record], more: Fit, less: Fit, name: str) -> float:
    """How many times its surroundings an added line is in what is left without it; 0 for what is no such
    line, and for one that the command has as well."""
    found = 0.0
    for member in more.hypothesis.members:
        line_hz = member.effect.line_hz(member.shared)
        if member.effect.name != name or line_hz is None or not issubclass(member.effect, AddedSignal):
            continue
        for record, e in zip(records, less.residuals, strict=True):
            left = bridged(e, record)
            for harmonic in range(1, HARMONICS + 1):
                if not has_line(record, harmonic * line_hz):
                    cycles = harmonic * line_hz * len(e) / record.fs_hz
                    found = max(found, above_surroundings(left, cycles))
    return found


def has_line(record: Record, line_hz: float) -> bool:
    """Whether a line stands out of a recording's voltage, or of how fast that moves."""
    cycles = line_hz * len(record.u) / record.fs_hz
    moves = np.abs(np.diff(record.u, prepend=record.u[:1]))
    return any(above_surroundings(signal, cycles) >= STANDS_OUT for signal in (record.u, moves))
