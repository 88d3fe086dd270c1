"""Signals that an effect adds and that neither voltage nor clock contains: a second input, or a line."""

from collections.abc import Sequence

import numpy as np

from torchpi.diagnosis.hypothesis import Fit, Hypothesis
from torchpi.diagnosis.hysteresis_model import plain
from torchpi.diagnosis.lines import STANDS_OUT, above_surroundings
from torchpi.diagnosis.noise import bridged
from torchpi.diagnosis.records import Record, seen
from torchpi.diagnosis.search import Search
from torchpi.stage.effects.added_signal import AddedSignal

HARMONICS = 3
"""Number of harmonics of a line that may stand out."""
PREDICTED = 0.5
"""Share of a recorded signal's variance that the voltage may predict for it to be a signal of its own."""


def has_a_signal_of_its_own(records: Sequence[Record], h: Hypothesis, name: str) -> bool:
    """Whether an effect adds what neither the voltage nor the clock contains: a second input, or a line."""
    for member in h.members:
        if member.effect.name == name:
            # A line that modulates a gain scales with the displacement, as any model error does.
            line_hz = member.effect.added_line_hz(member.values(0))
            if line_hz is not None and not any(has_line(record, line_hz) for record in records):
                return True
            if member.effect.takes_aux:
                return True
    return False


def has_a_recorded_signal(search: Search, final: Fit, name: str) -> bool:
    """Whether an effect takes a recorded signal that the voltage does not predict: all other errors of the
    model follow the voltage, and do not look like such a signal."""
    chain, members = search.chain, final.hypothesis.members
    signals = {m.aux for m in members if m.effect.name == name and m.effect.takes_aux}
    few_plays = Hypothesis(plain(seen(chain.records)))  # a hundred predict half of any slow signal by chance
    for signal in signals:
        predicted = whole = 0.0
        for i, record in enumerate(chain.records):
            aux = record.aux[signal][record.train]
            aux = aux - aux.mean()
            rows = chain.rows(few_plays, i)[:, record.train]
            rows = np.concatenate([rows, np.gradient(record.commanded(0))[None, record.train]])
            rows = rows - rows.mean(1, keepdims=True)
            weights = np.linalg.lstsq(rows.T, aux, rcond=1e-6)[0]
            predicted += float(((weights @ rows) ** 2).sum())
            whole += float(aux @ aux)
        if predicted > PREDICTED * whole:
            return False
    return bool(signals)


def stands_out(records: Sequence[Record], more: Fit, less: Fit, name: str) -> float:
    """Return how many times its spectral surroundings an added line is in the residual of the fit without it;
    0 for an effect that adds no line, and for a line that the command contains as well."""
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
    """Whether a line stands out in a recording's voltage, or in the speed of that voltage."""
    cycles = line_hz * len(record.u) / record.fs_hz
    moves = np.abs(np.diff(record.u, prepend=record.u[:1]))
    return any(above_surroundings(signal, cycles) >= STANDS_OUT for signal in (record.u, moves))
