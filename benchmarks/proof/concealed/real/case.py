"""One case: real recordings, the same with an effect injected, and the labels of the injection."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from concealed.cases import Case
from concealed.plant.severity import misfit_um, strength_for
from concealed.real import effects
from concealed.real.effects import Injection
from concealed.real.sources import SOURCES, Array, Record, Source, second_axis

SEVERITIES = (2.0, 20.0)
FAINTEST_DELAY = 60.0  # one sample of delay may be this severe, or more if no delay is less severe
STACKS, MIRRORS, MOTORS = (
    tuple(name for name in SOURCES if name.startswith(kind)) for kind in ("stack", "mirror", "motor")
)
EVERYWHERE: dict[str, Callable[..., Injection]] = {
    "sensor_lag": effects.sensor_lag,
    "sensor_nonlinearity": effects.sensor_nonlinearity,
    "quantization": effects.quantization,
    "hum": effects.hum,
    "drift_exponential": effects.drift("exponential"),
    "drift_linear": effects.drift("linear"),
    "drift_random_walk": effects.drift("random walk"),
    "ageing": effects.ageing,
    "gain_multiplicative": effects.gain_modulation("multiplicative"),
    "gain_additive": effects.gain_modulation("additive"),
    "dropouts": effects.dropouts,
}
DELAYS: dict[str, Callable[..., Injection]] = {
    "delay_sensor": effects.delay_of_the_sensor,
    "delay_command": effects.delay_of_the_command,
}
SECOND_AXIS = ("axis_recorded", "axis_not_recorded")
PLANS = [
    *((source, kind) for source in SOURCES for kind in EVERYWHERE),
    *((source, kind) for source in STACKS + MOTORS for kind in (*DELAYS, *SECOND_AXIS)),
    *((source, "axis_withheld") for source in MIRRORS),
]


def draw_case(data: Path, seed: int, index: int) -> Case:
    """Draw the case of this seed and index.

    The cut of a source is drawn once per seed, so that few untouched recordings serve all its cases.
    """
    source_name, kind = plan(seed, index)
    number = list(SOURCES).index(source_name)
    of_source = np.random.default_rng([seed, 2, number])
    source = SOURCES[source_name](data, of_source)
    rng = np.random.default_rng([seed, 3, index])
    injection = _injection(kind, data, source, rng, np.random.default_rng([seed, 4, number]))
    wanted = math.exp(rng.uniform(*np.log(SEVERITIES)))
    strength = _strength(injection, source, wanted)
    injected = injection.inject(strength)
    untouched = source.records
    if injection.needs_aux:
        injected, untouched = (_with_aux(records, injection.shown) for records in (injected, untouched))
    labels = {
        "track": "noise",
        "source": source_name,
        "recording": source.name,
        "kind": kind,
        "name": injection.name,
        "form": injection.form,
        "accepted": sorted(injection.accepted),
        "seed": seed,
        "index": index,
        "noise_rms_um": source.noise_um,
        "severity": None if kind == "axis_withheld" else severity(injection, strength, source),
        "parameters": {
            k: {"value": v, "unit": unit} for k, (v, unit) in injection.parameters(strength).items()
        },
        "untouched": f"untouched_{source.name}" + "_with_aux" * injection.needs_aux,
    }
    return Case([_columns(r) for r in injected], labels, untouched=[_columns(r) for r in untouched])


def untouched_recordings(seed: int, index: int) -> tuple[str, bool]:
    """Return the source of the recordings that the case is compared with, and whether with a second axis.

    Cases of one seed with the same answer here have the same untouched recordings.
    """
    source, kind = plan(seed, index)
    return source, kind == "axis_recorded"


def plan(seed: int, index: int) -> tuple[str, str]:
    """Return source and kind of the case; every pair occurs once before any occurs twice."""
    order = np.random.default_rng([seed, 1]).permutation(len(PLANS))
    return PLANS[order[index % len(PLANS)]]


def severity(injection: Injection, strength: float, source: Source) -> float:
    """Rms change by the effect after a best gain, without each record's own mean, in units of the noise."""
    changed = (injection.late or injection.inject)(strength)
    return misfit_um(_displacement(changed), _displacement(source.records)) / source.noise_um


def _displacement(records: list[Record]) -> Array:
    return np.concatenate([r.y - r.y.mean() for r in records])


def _strength(injection: Injection, source: Source, wanted: float) -> float:
    """Return the strength of the wanted severity within the bounds; an integer where it counts samples."""
    if injection.low == injection.high:
        return injection.low
    if injection.whole:
        counts = np.arange(injection.low, injection.high + 1)
        sizes = np.array([severity(injection, float(count), source) for count in counts])
        allowed = max(SEVERITIES[1], min(float(sizes[0]), FAINTEST_DELAY), float(sizes.min()))
        counts, sizes = counts[sizes <= allowed], sizes[sizes <= allowed]
        return float(counts[np.argmin(np.abs(np.log(sizes / wanted)))])
    strength, _ = strength_for(
        wanted, lambda s: severity(injection, s, source), injection.low, injection.high, injection.start
    )
    return strength


def _injection(
    kind: str, data: Path, source: Source, rng: np.random.Generator, of_source: np.random.Generator
) -> Injection:
    if kind == "axis_withheld":
        draw = effects.withheld
    elif kind in SECOND_AXIS:
        second = second_axis(data, of_source, source.records)
        draw = effects.cross_coupling(kind == "axis_recorded", second)
    else:
        draw = (EVERYWHERE | DELAYS)[kind]
    return draw(rng, source.records, source.noise_um)


def _with_aux(records: list[Record], second: list[Array]) -> list[Record]:
    return [replace(r, aux=r.aux | {"aux_v": w}) for r, w in zip(records, second, strict=True)]


def _columns(record: Record) -> dict[str, Array]:
    t = np.arange(record.y.size) / record.fs_hz
    return {"time_s": t, "input_v": record.u, "output_um": record.y, **record.aux}
