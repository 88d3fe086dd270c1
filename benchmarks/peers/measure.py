"""Fit with every peer and measure the time, the held-out error and the time of a step."""

import statistics
import time
from collections.abc import Sequence

import numpy as np
from row import Row
from task import Fitted, Peer, Task


def compare(task: Task, peers: Sequence[Peer]) -> list[Row]:
    """Fit with each peer, in rounds, so that other load slows all of them; sort by held-out error."""
    fits: dict[str, list[Fitted]] = {peer.name: [] for peer in peers}
    for round_ in range(max((peer.repeats for peer in peers), default=0)):
        for peer in peers:
            if round_ < peer.repeats:
                fits[peer.name].append(peer.fit(task))
    rows = [_row(task, peer, fits[peer.name]) for peer in peers]
    return sorted(rows, key=lambda row: row.rms_v)


def _row(task: Task, peer: Peer, fits: Sequence[Fitted]) -> Row:
    fit_s, compile_s = _times(peer, fits)
    errors = [task.clipped(fits[-1].voltage(pair)) - pair.u[0].numpy() for pair in task.held_out]
    error = np.concatenate(errors)
    return Row(
        peer,
        task.train.u.shape[1],
        fit_s,
        compile_s,
        float(np.sqrt(np.mean(error**2))),
        float(np.abs(error).max()),
        float(max(np.ptp(pair.u[0].numpy()) for pair in task.held_out)),
        _step_us(task, fits[-1]),
    )


def _times(peer: Peer, fits: Sequence[Fitted]) -> tuple[float, float | None]:
    """Return the median time to fit without compilation, and the time of compilation, s."""
    if peer.compiles:
        later = statistics.median(fit.fit_s for fit in fits[1:])
        return later, fits[0].fit_s - later
    if fits[0].compile_s is None:
        return statistics.median(fit.fit_s for fit in fits), None
    return (
        statistics.median(fit.fit_s - (fit.compile_s or 0.0) for fit in fits),
        statistics.median(fit.compile_s or 0.0 for fit in fits),
    )


def _step_us(task: Task, fitted: Fitted, samples: int = 2000, limit_s: float = 2.0) -> float | None:
    """Median time of a step called from Python, µs."""
    if fitted.step is None:
        return None
    motion = np.stack([part[0, :samples].numpy() for part in task.held_out[0].motion], 1).tolist()
    times: list[float] = []
    for y, rate, acceleration in motion:
        start = time.perf_counter()
        fitted.step(y, rate, acceleration)
        times.append(time.perf_counter() - start)
        if sum(times) > limit_s:
            break
    return 1e6 * statistics.median(times)
