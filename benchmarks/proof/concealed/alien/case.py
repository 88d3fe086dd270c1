"""One case of an alien plant: how it is recorded, what its plain simulation lacks, and the sealed labels."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from concealed.alien import electrical, mechanical, sensing
from concealed.alien.excitation import command, draw_waves, heldout
from concealed.alien.hysteresis import FAMILIES, draw_truth
from concealed.alien.open_set import OPEN
from concealed.alien.rig import PLACES, Act, Drawn, Form, Placed, Plain, Rig, simulate
from concealed.cases import Case, Columns
from concealed.names import STATIC
from concealed.plant.case import CLASHING
from concealed.plant.excitation import Reach, draw_aux
from concealed.plant.growth import beyond_plays_um
from concealed.plant.noise import draw_noise
from concealed.plant.physics import Array
from concealed.plant.rig import Run
from concealed.plant.severity import misfit_um, strength_for

LISTED = electrical.LISTED
assert mechanical.LISTED is sensing.LISTED is LISTED  # their forms are on it once they are imported
SEVERITIES, SEVERITIES_OF_SEVERAL = (0.5, 70.0), (2.0, 70.0)
SHORTEST, LONGEST, MOST = 2000, 50_000, 1_000_000  # samples
FASTEST_BY_PLAYS = 200_000  # samples up to which forty plays are refitted to what an effect changes
NULL_OF_FOUR = {"alien": 0, "open": 0, "noise": 1}  # the even cases of "noise" are real recordings
SINGLES_BEFORE: dict[str, Callable[[int], int]] = {
    "alien": lambda k: k - k // 4 - 1 - k // 8,
    "open": lambda k: k - k // 4 - 1,
    "noise": lambda k: k // 4,
}
Noise = Callable[[np.random.Generator, int, float], Array]


@dataclass(frozen=True)
class Recorded:
    """How the rig is recorded: none of it is physics of the plant."""

    remanent: bool
    rests: bool
    monitored: bool
    jitter: float  # of the period
    missing: float  # share of samples
    recordings: int
    waves: list[str]
    noise: str


def draw_case(track: str, seed: int, index: int, noise: Noise | None = None) -> Case:
    """The case of this seed and index; a quarter are nulls. `noise` replaces the simulated noise."""
    rng = np.random.default_rng([seed, index, *track.encode()])
    forms = _draw_forms(track, seed, index, rng)
    rig, recorded, waves, adequate = _draw_rig(rng, index, forms)
    runs, last = _draw_runs(rig, recorded, waves, rng, any(f.effect == "cross_coupling" for f in forms))
    times = [_times(rig, recorded, run, rng) for run in runs]
    plain: Plain = {}

    def readings(acts: Placed) -> Array:
        found = [simulate(rig, acts, run, t, plain) for run, t in zip(runs, times, strict=True)]
        return np.concatenate(found)

    without = readings(())
    acts, labels = [], []
    for form in forms:
        drawn = form.draw(rng, rig, runs)
        wanted = math.exp(rng.uniform(*np.log(SEVERITIES if len(forms) == 1 else SEVERITIES_OF_SEVERAL)))
        strength, reached = strength_for(
            wanted,
            lambda s, form=form, drawn=drawn: (
                misfit_um(readings([_placed(form, drawn, s)]), without) / rig.noise_um
            ),
            drawn.low,
            drawn.high,
            drawn.start,
        )
        act = _placed(form, drawn, strength)
        acts.append(act)
        labels.append(_label(form, drawn, strength, reached, rig))
        labels[-1]["severity_beyond_plays"] = (
            _beyond_plays(readings([act]), without, rig, runs, times)
            if without.size == sum(run.u.size - run.history for run in runs) <= FASTEST_BY_PLAYS
            else None
        )
    kinds = ["white", "ar", "flicker", "heavy_tailed"]
    colour = str(rng.choice(kinds)) if noise is None else "real"
    make = noise or (lambda g, n, rms: _noise(g, colour, n, rms))
    gain, offset, spread = (
        rng.uniform(-0.01, 0.01),
        rng.uniform(-2e-3, 2e-3),
        math.exp(rng.uniform(-10.8, -8.1)),
    )
    recordings = []
    for run, t in zip(runs, times, strict=True):
        y = simulate(rig, acts, run, t, noise_um=make(rng, t.size, rig.noise_um))
        u = run.u[run.history :]
        u = u[np.clip(np.floor(t * rig.fs_hz + 1e-6).astype(int), 0, u.size - 1)]
        if recorded.monitored:
            u = (1 + gain) * u + rig.span_v * (offset + spread * rng.standard_normal(u.size))
        recordings.append(_columns(t, u, y, run, rig))
    knowable = [
        a for a, form in zip(acts, forms, strict=True) if form.foreseeable or form.effect == "quantization"
    ]
    t = np.arange(last.u.size) / rig.fs_hz
    y = simulate(rig, knowable, last, t, noise_um=make(rng, t.size, rig.noise_um))
    u = (1 + gain) * last.u + rig.span_v * offset if recorded.monitored else last.u
    return Case(
        recordings,
        {
            "track": track,
            "seed": seed,
            "index": index,
            "fs_hz": rig.fs_hz,
            "timing": rig.timing,
            "family": rig.truth.family,
            "adequate": adequate,
            "recorded": vars(recorded) | {"noise": colour},
            "lower_v": rig.lower_v,
            "upper_v": rig.upper_v,
            "range_um": rig.sign * rig.range_um,
            "noise_rms_um": rig.noise_um,
            "names": [form.effect for form in forms if form in LISTED.all],
            "unknown": [form.effect for form in forms if form not in LISTED.all],
            "tolerated": sorted(_tolerated(rig, forms)),
            "effects": labels,
        },
        _columns(t, u, y, last, rig),
    )


def _draw_forms(track: str, seed: int, index: int, rng: np.random.Generator) -> list[Form]:
    """Every fourth case is a null. One of eight alien cases has two effects, every third of these three."""
    place = index % 4
    if place == NULL_OF_FOUR[track]:
        return []
    registry = OPEN if track == "open" else LISTED
    effects = registry.effects()
    if track == "alien" and index % 8 == 7:
        while True:
            names = rng.choice(effects, 3 if index % 24 == 23 else 2, replace=False).tolist()
            if not any(len(clash.intersection(names)) > 1 for clash in CLASHING):
                break
    else:
        order = np.random.default_rng([seed, *track.encode()]).permutation(len(effects))
        names = [effects[order[SINGLES_BEFORE[track](index) % len(effects)]]]
    return [(forms := registry.of(name))[rng.integers(len(forms))] for name in names]


def _draw_rig(
    rng: np.random.Generator, index: int, forms: Sequence[Form]
) -> tuple[Rig, Recorded, list, bool]:
    fs = float(rng.choice([200, 500, 1000, 2000, 5000, 10_000, 20_000, 50_000]))
    count = int(rng.integers(2 if any(f.effect == "load_change" for f in forms) else 1, 6))
    samples = int(math.exp(rng.uniform(math.log(SHORTEST), math.log(LONGEST))))
    if rng.random() < 0.02:
        samples = int(MOST * math.exp(rng.uniform(math.log(0.2), 0))) // count
    upper = float(rng.choice([1.0, 3.6, 5.0, 10.0, 12.0, 100.0, 150.0]))
    lower = -upper * float(rng.choice([0.0, 0.0, 0.2, 1.0]))
    reach = math.exp(rng.uniform(math.log(2), math.log(200)))
    needs_plays = any(f.effect in STATIC for f in forms)
    family = "pi" if needs_plays and rng.random() < 0.5 else FAMILIES[rng.integers(len(FAMILIES))]
    others = [f for f in FAMILIES if f not in ("pi", family)]
    rig = Rig(
        truth=draw_truth(family, rng, upper, reach),
        other=draw_truth(others[rng.integers(len(others))], rng, upper, reach),
        fs_hz=fs,
        fine=8 if samples * count <= 200_000 else 4,
        lower_v=lower,
        upper_v=upper,
        range_um=reach,
        sign=-1.0 if rng.random() < 0.15 else 1.0,
        noise_um=reach * math.exp(rng.uniform(math.log(3e-5), math.log(2e-3))),
        late=bool(rng.random() < 0.25),
        seed=int(rng.integers(2**31)),
        samples=samples,
    )
    waves, adequate = draw_waves(rng, count, samples)
    uneven = rng.random()
    recorded = Recorded(
        remanent=bool(rng.random() < 0.4),
        rests=bool(rng.random() < 0.6),
        monitored=bool(rng.random() < 0.25),
        jitter=rng.uniform(0.005, 0.05) if uneven < 0.06 else 0.0,
        missing=rng.uniform(1e-4, 5e-3) if uneven > 0.94 else 0.0,
        recordings=count,
        waves=[wave.__name__.strip("_") for wave in waves],
        noise="",
    )
    return rig, recorded, waves, adequate


def _draw_runs(
    rig: Rig, recorded: Recorded, waves: list, rng: np.random.Generator, coupled: bool
) -> tuple[list[Run], Run]:
    second = coupled or rng.random() < 0.1
    reach = Reach(rig.lower_v, rig.upper_v, rig.fs_hz, rig.samples)

    def run(u: Array, number: int, history: Array) -> Run:
        aux = None
        if second:
            aux = np.round(np.resize(draw_aux(rng, reach), u.size), 6)
            aux = np.concatenate([np.zeros(history.size), aux])
        loaded = number == recorded.recordings - 1
        return Run(np.concatenate([history, u]), aux, number, loaded, history.size)

    runs = []
    for number, wave in enumerate(waves):
        u = command(wave, rng, rig.samples, rig.lower_v, rig.upper_v, recorded.rests)
        history = np.zeros(0)
        if recorded.remanent:  # ramps that end elsewhere, so that plays and creep have a past
            corners = [0.0, *rng.uniform(rig.lower_v, rig.upper_v, int(rng.integers(3, 9))), 0.0]
            history = np.interp(
                np.linspace(0, len(corners) - 1, rig.samples // 2), range(len(corners)), corners
            )
        runs.append(run(u, number, np.round(history, 6)))
    last = run(heldout(rng, min(rig.samples, LONGEST), rig.lower_v, rig.upper_v), len(waves) + 7, np.zeros(0))
    return runs, last


def _times(rig: Rig, recorded: Recorded, run: Run, rng: np.random.Generator) -> Array:
    """The moments of the readings, s: even, but for jitter and for samples that were lost."""
    ticks = np.arange(run.u.size - run.history, dtype=float)
    if recorded.jitter:
        ticks[1:] += np.abs(recorded.jitter * rng.standard_normal(ticks.size - 1))
    if recorded.missing:
        ticks = ticks[(rng.random(ticks.size) >= recorded.missing) | (ticks == 0)]
    return ticks / rig.fs_hz


def _placed(form: Form, drawn: Drawn, strength: float) -> tuple[str, Act]:
    return form.place, lambda x, at: drawn.act(x, at, strength)


def _beyond_plays(
    with_effect: Array, without: Array, rig: Rig, runs: Sequence[Run], times: Sequence[Array]
) -> float:
    """What plays leave of an effect under the better timing convention, in units of the noise.

    The readings, with the effect and without, are those of all runs end to end, shape (readings,), µm.
    """
    other = replace(rig, late=not rig.late)
    of_other = np.concatenate([simulate(other, (), run, t) for run, t in zip(runs, times, strict=True)])
    plain = {rig.timing: without, other.timing: of_other}
    return beyond_plays_um(with_effect, plain, rig.timing, runs, rig.span_v) / rig.noise_um


def _noise(rng: np.random.Generator, colour: str, n: int, rms: float) -> Array:
    if colour != "heavy_tailed":
        return draw_noise(rng, colour, n, rms)
    return rms * rng.standard_t(4, n) / math.sqrt(2)


def _columns(t: Array, u: Array, y: Array, run: Run, rig: Rig) -> Columns:
    columns = {"time_s": t, "input_v": u, "output_um": y}
    if run.aux is not None:
        columns["aux_v"] = run.aux[
            run.history + np.minimum((t * rig.fs_hz + 1e-6).astype(int), len(run.u) - run.history - 1)
        ]
    return columns


def _label(form: Form, drawn: Drawn, strength: float, reached: float, rig: Rig) -> dict[str, object]:
    parameters = {
        key: {"value": float(value), "unit": unit}
        for key, (value, unit) in drawn.parameters(strength).items()
    }
    if form.effect == "delay" and rig.late:
        parameters["delay_s"]["or"] = (
            parameters["delay_s"]["value"] + 1 / rig.fs_hz
        )  # with the hold counted in
    return {
        "name": form.effect,
        "listed": form in LISTED.all,
        "form": form.form,
        "source": form.source,
        "foreign": form.foreign,
        "foreseeable": form.foreseeable,
        "place": form.place,
        "severity": reached,
        "strength": strength,
        "parameters": parameters,
    }


def _tolerated(rig: Rig, forms: Sequence[Form]) -> set[str]:
    tolerated = set(STATIC) if rig.truth.family != "pi" else set()
    tolerated |= {"delay"} if rig.late else set()
    return tolerated.union(*(form.near for form in forms)) - {form.effect for form in forms}


assert {form.place for form in [*LISTED.all, *OPEN.all]} <= set(PLACES)
