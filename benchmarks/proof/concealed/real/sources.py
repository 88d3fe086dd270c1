"""Real recordings, cut as a case needs them, and the noise in them.

The data lie beside the repository (`../shared/data`); their README states their owners. Only the unit is
changed here, and the zero of the stack's displacement, which is arbitrary.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LONGEST = 30_000  # samples of a recording
STACK_HZ, STACK_CYCLE = 200.0, 200
MIRROR_HZ = 6400.0
OTHERS_MOVE_AT = 5200  # samples; the test record's other two actuators stand still until then


@dataclass(frozen=True)
class Record:
    """One real recording: `u` V, `y` µm, other signals, and what came before its first sample.

    `period` is that of a stage in steady state under a periodic input, or None. Without a period, `before`
    holds the readings that precede `y`, latest last, and the first reading stands for all earlier ones.
    """

    u: Array  # shape: (samples,), V
    y: Array  # shape: (samples,), µm
    aux: dict[str, Array]
    fs_hz: float
    period: int | None
    before: Array

    def read_late(self, samples: int) -> Array:
        """Return the displacement delayed by `samples`, µm, shape (samples,)."""
        if self.period is not None:
            return _rolled(self.y, self.period, samples)
        return _later(self.y, self.before, samples)


@dataclass(frozen=True)
class Source:
    """The recordings of one case, all of one stage, and the rms of their noise, µm."""

    name: str
    records: list[Record]
    noise_um: float


def _rolled(signal: Array, period: int, samples: int) -> Array:
    """Delay a signal of whole periods by `samples`; its first samples are taken from one period later."""
    late = np.concatenate([signal[period - samples : period], signal[:-samples]])
    return late if samples else signal.copy()


def _later(signal: Array, before: Array, samples: int) -> Array:
    start = np.full(max(samples - before.size, 0), before[0] if before.size else signal[0])
    return np.concatenate([start, before[max(before.size - samples, 0) :], signal])[: signal.size]


def noise_of_periods(y: Array, period: int) -> float:
    """Rms of the deviation from the mean period, without each period's own mean, which is drift."""
    rows = y[: y.size // period * period].reshape(-1, period)
    rows = rows - rows.mean(axis=1, keepdims=True)
    deviation = rows - rows.mean(axis=0)
    return float(np.sqrt(np.mean(deviation**2) * len(rows) / (len(rows) - 1)))


def _stack(data: Path, rng: np.random.Generator, both: bool) -> Source:
    """The stack in its flexure: the 1 Hz sine, and for `both` the test record until other actuators move."""
    folder = data / "piezo_stack"
    sine = np.loadtxt(folder / "Model_Vi_Do.dat", usecols=(0, 4))
    zero = sine[0, 1]
    # Neighbouring cycles are compared, because the drift of 0.4 µm over all of them is not noise.
    cycles = sine[STACK_CYCLE : len(sine) // STACK_CYCLE * STACK_CYCLE, 1].reshape(-1, STACK_CYCLE)
    steps = np.diff(cycles - cycles.mean(axis=1, keepdims=True), axis=0)
    first = int(rng.choice([0, rng.integers(STACK_CYCLE, 5 * STACK_CYCLE)]))
    last = int(rng.integers(first + 4000, len(sine) + 1))
    tables = [(sine, first, last)]
    if both:
        tables.append((np.loadtxt(folder / "Test_Vi_Do_Di.dat", usecols=(0, 4)), 0, OTHERS_MOVE_AT))
    records = [
        Record(table[a:b, 0], table[a:b, 1] - zero, {}, STACK_HZ, None, table[:a, 1] - zero)
        for table, a, b in tables
    ]
    return Source("stack_both" if both else "stack_sine", records, float(steps.std() / np.sqrt(2)))


def _mirror(data: Path, rng: np.random.Generator, level_mv: int) -> Source:
    """One axis of the steering mirror with the voltages of the other two; two realisations of two periods."""
    with np.load(data / "steering_mirror" / "train.npz") as file:
        volts, metres = (file[f"{kind}_{level_mv}mV_train"].astype(np.float64) for kind in ("u", "y"))
    axis = int(rng.integers(3))
    others = [k for k in range(3) if k != axis]
    records, noises = [], []
    for realisation in sorted(rng.choice(volts.shape[2], 2, replace=False).tolist()):
        u = volts[:, :, realisation].transpose(2, 0, 1).reshape(-1, 3)
        y = 1e6 * metres[:, axis, realisation].T.ravel()
        aux = {f"aux_{k + 1}_v": u[:, k] for k in others}
        period = len(volts)
        records.append(Record(u[:, axis], y, aux, MIRROR_HZ, period, y[:0]))
        noises.append(noise_of_periods(y, period))
    name = f"mirror_{level_mv}mv_axis_{axis + 1}"
    return Source(name, records, float(np.sqrt(np.mean(np.square(noises)))))


def _motor(data: Path, rng: np.random.Generator, types: str) -> Source:
    """Commanded to measured current of a motor: amperes in place of V and µm."""
    records, noises = [], []
    for letter in types:
        with np.load(data / "motor_bench" / f"type_{letter}.npz") as file:
            period, fs = int(file["period"]), float(file["fs_hz"])
            u, y = file["iq_ref_a"].astype(np.float64), file["iq_a"].astype(np.float64)
        count = LONGEST // len(types) // period
        first = int(rng.integers(1, u.size // period - count + 1)) * period  # the first period is left out
        inside = slice(first, first + count * period)
        records.append(Record(u[inside], y[inside], {}, fs, None, y[:first]))
        noises.append(noise_of_periods(y[inside], period))
    return Source(f"motor_{types}", records, float(np.sqrt(np.mean(np.square(noises)))))


SOURCES: dict[str, Callable[[Path, np.random.Generator], Source]] = {
    "stack_sine": lambda data, rng: _stack(data, rng, both=False),
    "stack_both": lambda data, rng: _stack(data, rng, both=True),
    "mirror_100": lambda data, rng: _mirror(data, rng, 100),
    "mirror_200": lambda data, rng: _mirror(data, rng, 200),
    "mirror_300": lambda data, rng: _mirror(data, rng, 300),
    "motor_a": lambda data, rng: _motor(data, rng, "a"),
    "motor_b": lambda data, rng: _motor(data, rng, "b"),
    "motor_ab": lambda data, rng: _motor(data, rng, "ab"),
}


def draw_residual(
    data: Path, case: np.random.Generator
) -> Callable[[np.random.Generator, int, float], Array]:
    """Return a source of real noise: how recordings of one source, drawn here, deviate from repeating.

    The function takes a generator, a number of samples and an rms; pieces follow one another sample for
    sample, whatever the sample rates.
    """
    rows = _RESIDUALS[str(case.choice(sorted(_RESIDUALS)))](data)
    rows = rows / rows.std()

    def noise(rng: np.random.Generator, samples: int, rms: float) -> Array:
        pieces = [
            rows[k] * rng.choice([-1, 1]) for k in rng.integers(len(rows), size=2 + samples // rows.shape[1])
        ]
        start = int(rng.integers(rows.shape[1]))
        return rms * np.concatenate(pieces)[start : start + samples]

    return noise


def _deviations(y: Array, period: int) -> Array:
    """Deviations of all periods from the mean period, end to end, so that slow noise is kept."""
    rows = y[: y.size // period * period].reshape(-1, period)
    deviation = (rows - rows.mean(axis=0)).ravel() * np.sqrt(len(rows) / max(len(rows) - 1, 1))
    return deviation - deviation.mean()


def _of_the_stack(data: Path) -> Array:
    y = np.loadtxt(data / "piezo_stack" / "Model_Vi_Do.dat", usecols=4)
    cycles = y[STACK_CYCLE : len(y) // STACK_CYCLE * STACK_CYCLE].reshape(-1, STACK_CYCLE)
    steps = np.diff(cycles - cycles.mean(axis=1, keepdims=True), axis=0) / np.sqrt(2)
    return steps.reshape(1, -1)


def _of_the_mirror(data: Path) -> Array:
    with np.load(data / "steering_mirror" / "train.npz") as file:
        y = file["y_300mV_train"].astype(np.float64)
    return ((y[..., 0] - y[..., 1]) / np.sqrt(2)).reshape(len(y), -1).T


def _of_the_motor(data: Path) -> Array:
    rows = []
    for letter in "ab":
        with np.load(data / "motor_bench" / f"type_{letter}.npz") as file:
            period = int(file["period"])
            rows.append(_deviations(file["iq_a"].astype(np.float64)[period:], period))
    shortest = min(row.size for row in rows)
    return np.array([row[:shortest] / row.std() for row in rows])


_RESIDUALS: dict[str, Callable[[Path], Array]] = {
    "stack": _of_the_stack,
    "mirror": _of_the_mirror,
    "motor": _of_the_motor,
}


def second_axis(data: Path, rng: np.random.Generator, records: list[Record]) -> list[Array]:
    """Return an unrelated real signal for each record: another voltage of the mirror, V.

    It is taken sample for sample, whatever the rates, from a random place, and repeats if it is too short.
    """
    with np.load(data / "steering_mirror" / "train.npz") as file:
        voltage = file["u_300mV_train"][:, 2, int(rng.integers(6)), 0].astype(np.float64)
    return [np.resize(np.roll(voltage, int(rng.integers(voltage.size))), r.u.size) for r in records]
