"""Effects that can be injected into recordings exactly: after the sensor, before the command, or in parallel.

Each is a function of its strength with everything else drawn before, so that the strength can be searched for
the severity that a case is to have.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from concealed.real.sources import Array, Record
from scipy.signal import lfilter

LAG_GROUP = frozenset({"amplifier_lag", "sensor_lag"})
CURVES = frozenset({"sensor_nonlinearity", "input_nonlinearity"})
Parameters = dict[str, tuple[float, str]]


@dataclass(frozen=True)
class Injection:
    """An effect with everything drawn except its strength.

    `accepted` are the right names: its own, and those that u and y cannot tell apart from it. It is empty if
    the only right answer is that something without a name is there.
    """

    name: str
    form: str
    accepted: frozenset[str]
    inject: Callable[[float], list[Record]]
    low: float
    high: float
    start: float
    parameters: Callable[[float], Parameters]
    whole: bool = False  # the strength is a count of samples
    late: Callable[[float], list[Record]] | None = None  # a delay of the command, as the readings show it
    needs_aux: bool = False  # the untouched recording has the second axis as well
    shown: list[Array] = field(default_factory=list)  # the second axis that the files have


def sensor_lag(rng: np.random.Generator, records: list[Record], noise_um: float) -> Injection:
    """y' = 2 pi f_c (x - y): for readings that are linear between samples, or exactly if periodic."""
    fs = records[0].fs_hz

    def one(record: Record, cutoff_hz: float) -> Record:
        if record.period is not None:
            spectrum = np.fft.rfft(record.y)
            spectrum /= 1 + 1j * np.fft.rfftfreq(record.y.size, 1 / fs) / cutoff_hz
            return replace(record, y=np.fft.irfft(spectrum, record.y.size))
        before = record.before if record.before.size else record.y[:1]
        x = np.concatenate([before, record.y])
        w = 2 * math.pi * cutoff_hz / fs
        # y[k] = e^-w y[k-1] + a x[k-1] + b x[k], exact for a ramp between two samples.
        decay = math.exp(-w)
        b = 1 - (1 - decay) / w
        a = (1 - decay) / w - decay
        lagged, _ = lfilter([b, a], [1, -decay], x - x[0], zi=[0.0])
        return replace(record, y=(lagged + x[0])[before.size :])

    # The strength is a time, so that it starts from zero.
    return Injection(
        "sensor_lag",
        "one pole",
        LAG_GROUP,
        lambda s: [one(r, fs / (2 * math.pi * s)) for r in records],
        1e-4,
        200.0,
        0.5,
        lambda s: {"cutoff_hz": (fs / (2 * math.pi * s), "Hz")},
    )


def delay_of_the_sensor(rng: np.random.Generator, records: list[Record], noise_um: float) -> Injection:
    """y(k - d): the readings are delayed by whole samples."""
    fs = records[0].fs_hz
    late = _late(records)
    return _delay("sensor", fs, late, late)


def delay_of_the_command(rng: np.random.Generator, records: list[Record], noise_um: float) -> Injection:
    """u(k + d) in the file: the stage responds to a command that was written whole samples earlier."""
    fs = records[0].fs_hz

    def one(record: Record, d: int) -> Record:
        if record.period is not None:
            return replace(record, u=np.concatenate([record.u[d:], record.u[:d]]))
        kept = record.u.size - d  # the last samples have no command any more
        aux = {name: signal[:kept] for name, signal in record.aux.items()}
        return replace(record, u=record.u[d:], y=record.y[:kept], aux=aux)

    return _delay("command", fs, lambda d: [one(r, d) for r in records], _late(records))


def _late(records: list[Record]) -> Callable[[int], list[Record]]:
    return lambda d: [replace(r, y=r.read_late(d)) for r in records]


def _delay(
    form: str,
    fs_hz: float,
    inject: Callable[[int], list[Record]],
    late: Callable[[int], list[Record]],
) -> Injection:
    return Injection(
        "delay",
        form,
        frozenset({"delay"}),
        lambda s: inject(round(s)),
        1.0,
        20.0,
        1.0,
        lambda s: {"delay_s": (round(s) / fs_hz, "s")},
        whole=True,
        late=lambda s: late(round(s)),
    )


def sensor_nonlinearity(rng: np.random.Generator, records: list[Record], noise_um: float) -> Injection:
    """y + a2 y² + a3 y³; quadratic, cubic, or both."""
    peak = max(float(np.max(np.abs(r.y))) for r in records)
    form = str(rng.choice(["quadratic", "cubic", "both"]))
    a2 = float(rng.choice([-1, 1])) / peak * (form != "cubic")
    a3 = float(rng.choice([-1, 1])) / peak**2 * (form != "quadratic")

    def one(record: Record, s: float) -> Record:
        return replace(record, y=record.y + s * (a2 * record.y**2 + a3 * record.y**3))

    def parameters(s: float) -> Parameters:
        known = {"a2_per_um": (s * a2, "1/um"), "a3_per_um2": (s * a3, "1/um^2")}
        return {key: value for key, value in known.items() if value[0]}

    inject = _each(records, one)
    return Injection("sensor_nonlinearity", form, CURVES, inject, 1e-6, 0.5, 1e-2, parameters)


def quantization(rng: np.random.Generator, records: list[Record], noise_um: float) -> Injection:
    """round(y / lsb) lsb"""

    def one(record: Record, lsb: float) -> Record:
        return replace(record, y=np.round(record.y / lsb) * lsb)

    low, high = noise_um, 200 * noise_um
    accepted = frozenset({"quantization"})
    return Injection(
        "quantization",
        "rounded",
        accepted,
        _each(records, one),
        low,
        high,
        20 * noise_um,
        lambda s: {"lsb_um": (s, "um")},
    )


def hum(rng: np.random.Generator, records: list[Record], noise_um: float) -> Injection:
    """A mains line, a little off 50 or 60 Hz, with or without its second and third harmonic."""
    mains = float(rng.choice([50.0, 60.0])) * (1 + 1e-3 * rng.uniform(-1, 1))
    shares = [1.0, rng.uniform(0.1, 0.5), rng.uniform(0.05, 0.3)] if rng.random() < 0.5 else [1.0]
    shares = [a for order, a in enumerate(shares, 1) if order * mains < 0.45 * records[0].fs_hz]
    phases = rng.uniform(0, 2 * math.pi, (len(records), len(shares)))

    def one(record: Record, s: float, phase: Array) -> Record:
        t = np.arange(record.y.size) / record.fs_hz
        lines = [
            a * np.sin(2 * math.pi * order * mains * t + p)
            for order, (a, p) in enumerate(zip(shares, phase, strict=True), 1)
        ]
        return replace(record, y=record.y + s * np.sum(lines, axis=0))

    return Injection(
        "hum",
        f"{len(shares)} lines",
        frozenset({"hum"}),
        lambda s: [one(r, s, p) for r, p in zip(records, phases, strict=True)],
        *_sizes(noise_um),
        lambda s: {"mains_hz": (mains, "Hz")},
    )


def drift(form: str) -> Callable[[np.random.Generator, list[Record], float], Injection]:
    """Slow drift of the readings: "exponential", "linear" or "random walk"; its size differs by record."""

    def draw(rng: np.random.Generator, records: list[Record], noise_um: float) -> Injection:
        longest_s = max(r.y.size / r.fs_hz for r in records)
        tau_s = longest_s * rng.uniform(0.15, 0.6)
        sign, known = float(rng.choice([-1, 1])), {}
        courses = []
        for record in records:
            t = np.arange(record.y.size) / record.fs_hz
            if form == "exponential":
                course, known = 1 - np.exp(-t / tau_s), {"tau_s": (tau_s, "s")}
            elif form == "linear":
                course = t / longest_s
            else:
                course = np.cumsum(rng.standard_normal(t.size)) / math.sqrt(t.size)
            courses.append(sign * rng.uniform(0.6, 1.4) * course)
        names = {"thermal_drift"} if form == "random walk" else {"thermal_drift", "leakage"}
        return Injection(
            "thermal_drift",
            form,
            frozenset(names),
            lambda s: [replace(r, y=r.y + s * c) for r, c in zip(records, courses, strict=True)],
            *_sizes(noise_um),
            lambda s: known,
        )

    return draw


def ageing(rng: np.random.Generator, records: list[Record], noise_um: float) -> Injection:
    """y (1 - loss t / T): the gain falls in each recording, which is a slow gain modulation as well."""

    def one(record: Record, loss: float) -> Record:
        return replace(record, y=record.y * (1 - loss * np.linspace(0, 1, record.y.size)))

    accepted = frozenset({"ageing", "gain_modulation"})
    return Injection("ageing", "with time", accepted, _each(records, one), 1e-6, 0.9, 1e-2, lambda s: {})


def gain_modulation(form: str) -> Callable[[np.random.Generator, list[Record], float], Injection]:
    """y (1 + m sin) or y + A sin, at least three cycles per recording, at most 3 Hz, not driven by u."""

    def draw(rng: np.random.Generator, records: list[Record], noise_um: float) -> Injection:
        shortest_s = min(r.y.size / r.fs_hz for r in records)
        frequency_hz = _between_the_lines(rng, records, 3 / shortest_s)
        phases = rng.uniform(0, 2 * math.pi, len(records))

        def one(record: Record, s: float, phase: float) -> Record:
            t = np.arange(record.y.size) / record.fs_hz
            wave = s * np.sin(2 * math.pi * frequency_hz * t + phase)
            return replace(record, y=record.y * (1 + wave) if form == "multiplicative" else record.y + wave)

        size = (1e-6, 0.9, 1e-2) if form == "multiplicative" else _sizes(noise_um)
        return Injection(
            "gain_modulation",
            form,
            frozenset({"gain_modulation"}),
            lambda s: [one(r, s, p) for r, p in zip(records, phases, strict=True)],
            *size,
            lambda s: {"frequency_hz": (frequency_hz, "Hz")},
        )

    return draw


def dropouts(rng: np.random.Generator, records: list[Record], noise_um: float) -> Injection:
    """Single readings that are zero, or off by a random amount; the strength is their share or their size."""
    form = str(rng.choice(["zero", "spikes"]))
    count = int(rng.integers(5, 40))
    places, sizes, order = [], [], []
    for record in records:
        places.append(1 + rng.choice(record.y.size - 2, count, replace=False))
        sizes.append(rng.choice([-1, 1], count) * rng.uniform(0.5, 1.5, count))
        order.append(rng.permutation(record.y.size - 2) + 1)

    def one(record: Record, s: float, number: int) -> Record:
        y = record.y.copy()
        if form == "zero":
            y[order[number][: max(round(s * y.size), 3)]] = 0.0
        else:
            y[places[number]] += s * sizes[number]
        return replace(record, y=y)

    size = (1e-5, 5e-2, 1e-3) if form == "zero" else (noise_um, 1e5 * noise_um, 100 * noise_um)
    return Injection(
        "dropouts",
        form,
        frozenset({"dropouts"}),
        lambda s: [one(r, s, k) for k, r in enumerate(records)],
        *size,
        lambda s: {},
    )


def cross_coupling(recorded: bool, second: list[Array]) -> Callable[..., Injection]:
    """y + c w: a second axis that the files have, or that was not recorded and so cannot be named."""

    def draw(rng: np.random.Generator, records: list[Record], noise_um: float) -> Injection:
        c = 1 / max(float(np.std(w)) for w in second) * float(rng.choice([-1, 1]))
        return Injection(
            "cross_coupling",
            "recorded" if recorded else "not recorded",
            frozenset({"cross_coupling"}) if recorded else frozenset(),
            lambda s: [replace(r, y=r.y + s * c * w) for r, w in zip(records, second, strict=True)],
            *_sizes(noise_um),
            lambda s: {"coupling_um_per_v": (s * c, "um/V")},
            needs_aux=recorded,
            shown=second if recorded else [],
        )

    return draw


def withheld(rng: np.random.Generator, records: list[Record], noise_um: float) -> Injection:
    """Leave one of the recorded voltages out of the files: the motion that it causes then has no name."""
    out = str(rng.choice(sorted(records[0].aux)))

    def one(record: Record) -> Record:
        return replace(record, aux={k: v for k, v in record.aux.items() if k != out})

    return Injection(
        "cross_coupling",
        "withheld",
        frozenset(),
        lambda s: [one(r) for r in records],
        1.0,
        1.0,
        1.0,
        lambda s: {},
    )


def _each(records: list[Record], one: Callable[[Record, float], Record]) -> Callable[[float], list[Record]]:
    return lambda s: [one(record, s) for record in records]


def _sizes(noise_um: float) -> tuple[float, float, float]:
    return 0.1 * noise_um, 1e3 * noise_um, 10 * noise_um


def _between_the_lines(rng: np.random.Generator, records: list[Record], slowest_hz: float) -> float:
    """Draw a frequency up to 3 Hz that is neither a line of a periodic input nor half-way between two."""
    lines_hz = 1.0 if records[0].period is None else records[0].fs_hz / records[0].period
    while True:
        f = math.exp(rng.uniform(math.log(min(slowest_hz, 2.0)), math.log(3.0)))
        place = 2 * f / lines_hz
        if abs(place - round(place)) > 0.2:
            return f
