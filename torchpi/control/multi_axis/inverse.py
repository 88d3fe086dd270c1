"""The inverse of an identified multi-axis stage, with look-ahead.

The best linear inverse, a matrix of filters, turns the trajectories into a first voltage. Then the stage is
simulated with that voltage, and filters for small motions turn the remaining displacement error into a
correction, several times:

    u_0 = A * y_d,   u_j = u_{j-1} + B * (y_d - ŷ(u_{j-1}))

It is model-inverse iterative learning (Bristow, Tharayil and Alleyne, IEEE Control Systems 26(3), 2006), here
against the identified stage and in a pipeline: each pass lags the one before by its look-ahead, so that all
of them together are a causal filter of a trajectory known some samples ahead. It converges faster the smaller
the hysteresis is relative to the linear part. The identified stage is its only model.
"""

from collections.abc import Sequence

import numpy as np

from torchpi.errors import StageError
from torchpi.operators.filters import filter_matrix
from torchpi.stage.multi_axis import MultiAxisStage, MultiAxisStream

LINES = 2048
"""Number of frequencies at which the linear inverses are computed, up to the Nyquist frequency."""
FLAT, LAST = 0.17, 0.24
"""Shares of the sample rate: up to the first the filters invert, and they fade out until the second."""
HALF_LENGTH = 256
"""Half length of the filters, samples."""
PASSES = 3
LARGEST = 1e9
"""Limit of a voltage or a displacement if none is known."""
SMALL, MEANS = 0.02, 2
"""Size of a small motion relative to the trajectories', and number of trajectories in an average."""


def linear_inverses(
    stage: MultiAxisStage, rms_v: float, band_hz: float, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Return filters that turn desired displacements into voltages that move the stage accordingly.

    The first invert the best linear approximation in the trajectories' band (Pintelon and Schoukens,
    System Identification, 2012, ch. 3). The second are for small motions added to such trajectories, as
    corrections are: hysteresis and a stiffness that follows the amplitude respond to them differently.

    Args:
        stage: Identified stage, with as many outputs as inputs.
        rms_v: RMS voltage of each input, V.
        band_hz: Highest frequency at which trajectories have content, Hz.
        seed: Seed of the random phases.

    Returns:
        (2 `HALF_LENGTH` + 1, inputs, outputs) each, V/µm; the middle tap acts without delay.

    Raises:
        StageError: Not as many outputs as inputs, or a band that is not within that of the filters.
    """
    m, length, last = stage.inputs, 2 * LINES, int(2 * LINES * LAST)
    if stage.outputs != m:
        raise StageError(f"inverse: found {m} inputs and {stage.outputs} outputs, expected equal numbers")
    highest = FLAT * stage.sample_rate_hz
    if not 0 < band_hz <= highest:
        raise StageError(
            f"band_hz: found {band_hz:g}, expected a number up to {highest:g} at this sample rate"
        )
    random = np.random.default_rng(seed)
    in_band = int(band_hz / stage.sample_rate_hz * length)
    large, moved = np.zeros((last, m, m), complex), []
    for _ in range(MEANS):
        bases = rms_v * _multisines(random, m, in_band)
        spectra, answers = np.fft.rfft(bases, axis=1), _steady(stage, bases)
        large[:in_band] += _solved(spectra, answers)[:in_band] / MEANS
        # All inputs move, then each alone.
        for alone in (None, *range(m)):
            base = bases[:1] if alone is None else bases[:1] * (np.arange(m) == alone)
            beside = SMALL * rms_v * _multisines(random, m, last)
            differs = _steady(stage, base + beside) - _steady(stage, base)
            moved.append(_solved(np.fft.rfft(beside, axis=1), differs)[:last])
    # The least-squares solution of (small response)(inverse) = 1 is cautious where the responses differ.
    back = [each.conj().swapaxes(1, 2) for each in moved]
    squares = np.sum([each @ other for each, other in zip(moved, back, strict=True)], axis=0)
    small = np.linalg.solve(squares.swapaxes(1, 2), np.sum(back, axis=0).swapaxes(1, 2)).swapaxes(1, 2)
    first = np.concatenate([np.linalg.inv(large[:in_band]), small[in_band:]])
    return _filters(first), _filters(small)


def _multisines(random: np.random.Generator, m: int, last: int) -> np.ndarray:
    """Return orthogonal multisines, random phase, rms 1, (runs, samples, inputs); as many runs as inputs."""
    phases = np.exp(2j * np.pi * random.random((last, m)))
    turns = np.exp(2j * np.pi * np.outer(np.arange(m), np.arange(m)) / m)
    spectra = np.zeros((m, LINES + 1, m), complex)
    spectra[:, 1 : last + 1] = turns[:, None] * phases
    u = np.fft.irfft(spectra, axis=1)
    return np.asarray(u / u.std())


def _steady(stage: MultiAxisStage, u: np.ndarray) -> np.ndarray:
    """Return spectra of the steady-state displacements, (runs, lines, outputs), for periodic voltages."""
    found = []
    for run in u:
        y = MultiAxisStream(stage).block(np.concatenate([run, run, run, run[: stage.delay_samples]]))
        found.append(np.fft.rfft(y[-len(run) :], axis=0))
    return np.array(found)


def _solved(inputs: np.ndarray, answers: np.ndarray) -> np.ndarray:
    """Return responses (lines, inputs, outputs) without that at 0 Hz, from the spectra of the runs."""
    across = inputs.swapaxes(0, 1)[1:]
    usable = np.abs(across).max((1, 2)) > 1e-9 * np.abs(across).max()
    response = np.zeros((len(across), across.shape[2], answers.shape[2]), complex)
    response[usable] = np.linalg.solve(across[usable], answers.swapaxes(0, 1)[1:][usable])
    return response


def _filters(found: np.ndarray) -> np.ndarray:
    """Return filters (taps, inputs, outputs) for inverses (lines, outputs, inputs) from the first line on."""
    last, m = len(found), found.shape[1]
    inverse = np.zeros((LINES + 1, m, m), complex)
    inverse[1 : last + 1] = found.swapaxes(1, 2)
    inverse[0] = inverse[1:4].mean(0).real
    fade = np.clip((np.arange(LINES + 1) / (2 * LINES) - FLAT) / (LAST - FLAT), 0, 1)
    inverse *= np.square(np.cos(np.pi / 2 * fade))[:, None, None]
    taps = np.roll(np.fft.irfft(inverse, axis=0), HALF_LENGTH, axis=0)[: 2 * HALF_LENGTH + 1]
    return np.asarray(taps * np.kaiser(2 * HALF_LENGTH + 1, 3.0)[:, None, None])


class FilterMatrix:
    """Filters of several inputs and outputs, window after window, delayed by `HALF_LENGTH` samples."""

    def __init__(self, taps: np.ndarray) -> None:
        self.taps = taps  # (taps, outputs, inputs)
        self.known = np.zeros((len(taps) - 1, taps.shape[2]))

    def advance(self, x: np.ndarray) -> np.ndarray:
        known = np.concatenate([self.known, x])
        self.known = known[len(x) :]
        found = np.empty((len(x), self.taps.shape[1]))
        filter_matrix(known, self.taps, found)
        return found


class Delay:
    """A delay by a number of samples, window after window."""

    def __init__(self, samples: int, channels: int) -> None:
        self.known = np.zeros((samples, channels))

    def advance(self, x: np.ndarray) -> np.ndarray:
        known = np.concatenate([self.known, x])
        self.known = known[len(x) :]
        return known[: len(x)]


class MultiAxisInverse:
    """Compensator whose voltages move a multi-axis stage along desired trajectories.

    Args:
        stage: Identified stage, with as many outputs as inputs.
        first: Filters of the linear inverse, (taps, inputs, outputs), V/µm, from `linear_inverses`.
        corrections: Filters for small motions, of the same shape and unit, also from `linear_inverses`.
        passes: Number of corrections against the stage; with none it is the linear inverse.
        limits_v: (inputs, 2), V, least and largest voltage of each; unlimited by default.
        accepted_um: (outputs,), µm; displacements further from 0 are held; by default none are.

    Raises:
        StageError: Filters, limits or passes that do not fit the stage or each other.

    Attributes:
        preview: How many samples ahead `step` takes the trajectories.
        held_inputs: Samples that were not finite or not accepted, each replaced by the last accepted one.
        limited_outputs: Samples at which the limits changed a voltage.
    """

    def __init__(
        self,
        stage: MultiAxisStage,
        first: np.ndarray,
        corrections: np.ndarray,
        passes: int = PASSES,
        limits_v: np.ndarray | None = None,
        accepted_um: np.ndarray | None = None,
    ) -> None:
        if passes < 0:
            raise StageError(f"passes: found {passes}, expected a whole number, 0 or more")
        expected = (len(first), stage.inputs, stage.outputs)
        for name, taps in (("first", first), ("corrections", corrections)):
            if taps.shape != expected or len(taps) % 2 == 0:
                raise StageError(
                    f"{name}: found an array of shape {taps.shape}, expected (odd, {expected[1:]})"
                )
        self.stage, self.first, self.corrections, self.passes = stage, first, corrections, passes
        any_v, any_um = np.tile([-LARGEST, LARGEST], (stage.inputs, 1)), np.full(stage.outputs, LARGEST)
        self.limits_v = any_v if limits_v is None else np.asarray(limits_v, dtype=np.float64)
        self.accepted_um = any_um if accepted_um is None else np.asarray(accepted_um, dtype=np.float64)
        if self.limits_v.shape != any_v.shape or not (self.limits_v[:, 0] < self.limits_v[:, 1]).all():
            raise StageError(
                f"limits_v: found {self.limits_v.tolist()}, expected the least and the largest voltage of "
                f"each of {stage.inputs} inputs"
            )
        if self.accepted_um.shape != any_um.shape or not (self.accepted_um > 0).all():
            raise StageError(
                f"accepted_um: found {self.accepted_um.tolist()}, expected {stage.outputs} positive numbers"
            )
        self.half = len(first) // 2
        self.preview = self.half + passes * (stage.delay_samples + self.half)
        self.reset()

    def reset(self) -> None:
        """Reset to rest."""
        half, stage = self.half, self.stage
        self._first = FilterMatrix(self.first)
        # Each pass lags the one before by half a filter and the stage's look-ahead.
        self._desired = [Delay(half + stage.delay_samples, stage.outputs) for _ in range(self.passes)]
        self._stages = [MultiAxisStream(stage) for _ in range(self.passes)]
        self._filters = [FilterMatrix(self.corrections) for _ in range(self.passes)]
        self._voltages = [Delay(stage.delay_samples + half, stage.inputs) for _ in range(self.passes)]
        self._accepted = np.zeros(stage.outputs)
        self.held_inputs = self.limited_outputs = 0

    def block(self, yd: np.ndarray) -> np.ndarray:
        """Return voltages (time, inputs), V, for trajectories (time, outputs), µm, `preview` samples ahead.

        Raises:
            StageError: A wrong number of trajectories, or ones along which the stage has no bounded response.
        """
        if yd.ndim != 2 or yd.shape[1] != self.stage.outputs:
            raise StageError(
                f"trajectories: found an array of shape {yd.shape}, expected (time, {self.stage.outputs})"
            )
        desired, offset = self._held(yd), self.stage.offset()
        u = self._first.advance(desired)
        for late, stage, filters, voltages in zip(
            self._desired, self._stages, self._filters, self._voltages, strict=True
        ):
            desired = late.advance(desired)
            lacking = desired - (stage.block(u) - offset)
            u = voltages.advance(u) + filters.advance(lacking)
        limited: np.ndarray = np.clip(u, *self.limits_v.T)
        self.limited_outputs += int((limited != u).any(1).sum())
        return limited

    def step(self, yd: Sequence[float]) -> list[float]:
        """Return voltages, V, for desired displacements, µm, `preview` samples ahead."""
        return [float(u) for u in self.block(np.asarray(yd, dtype=np.float64).reshape(1, -1))[0]]

    def _held(self, yd: np.ndarray) -> np.ndarray:
        """Return the trajectories, with the last accepted sample in place of those that are not accepted."""
        desired = yd.astype(np.float64)
        # A comparison with NaN is false.
        for t in np.flatnonzero(~(np.abs(desired) <= self.accepted_um).all(1)):
            desired[t] = desired[t - 1] if t else self._accepted
            self.held_inputs += 1
        if len(desired):
            self._accepted = desired[-1]
        return desired
