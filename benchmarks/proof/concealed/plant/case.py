"""One concealed case: a rig, what its plain simulation lacks, its recordings, and the sealed labels."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from concealed.cases import Case
from concealed.names import STATIC, group_of
from concealed.plant import excitation
from concealed.plant.conditions import (
    PLAIN,
    Conditions,
    Monitor,
    draw_conditions,
    draw_history,
    draw_monitor,
    without_holds,
)
from concealed.plant.effects import EFFECTS, Proposal
from concealed.plant.growth import TICKS_LATE, beyond_plays_um
from concealed.plant.hysteresis import Plays, draw_hysteresis
from concealed.plant.noise import draw_noise
from concealed.plant.physics import Array, Physics
from concealed.plant.rig import Rig, Run, simulate
from concealed.plant.severity import misfit_um, readings, severity, strength_for
from concealed.plant.unknowns import UNKNOWNS

TRACKS = (
    "single_pi",
    "single_other",
    "pairs",
    "triples",
    "unknown",
    "nulls_pi",
    "nulls_other",
    "crime",
    "nulls_conditions",
)
SEVERITIES = (0.5, 70.0)
# Pairs that no recording of u and y could tell apart from one effect alone, or that hide one another.
CLASHING = (
    frozenset({"amplifier_lag", "sensor_lag"}),
    frozenset({"resonance", "second_mode"}),
    frozenset({"backlash", "stiction"}),
    frozenset({"creep", "leakage"}),
    STATIC,
)


@dataclass(frozen=True)
class Settings:
    """The choices of a case that are not drawn."""

    track: str
    seed: int
    index: int
    excitation: str = "rich"
    samples: int = 33_000
    timing: str = "mixed"
    only: tuple[str, ...] = ()
    severity: float | None = None
    conditions: Conditions = PLAIN
    """Not used by the track `nulls_conditions`, which draws its conditions."""


def draw_case(settings: Settings) -> Case:
    """The case of this track, seed and index; the same arguments give the same case."""
    rng = np.random.default_rng([settings.seed, TRACKS.index(settings.track), settings.index])
    # The conditions have a generator of their own, so that cases under plain conditions remain the same.
    around = np.random.default_rng([settings.seed, TRACKS.index(settings.track), settings.index, 6])
    conditions = settings.conditions
    if settings.track == "nulls_conditions":
        conditions = draw_conditions(settings.index, around)
    rig = _draw_rig(settings, rng)
    reach = excitation.Reach(rig.lower_v, rig.span_v, rig.fs_hz, settings.samples)
    commands = [np.round(u, 6) for u in excitation.draw_recordings(settings.excitation, rng, reach)]
    names = settings.only or _draw_names(settings, rng)
    second_axis = "cross_coupling" in names or rng.random() < 0.15
    auxes = [np.round(excitation.draw_aux(rng, reach), 6) if second_axis else None for _ in range(4)]
    runs = [Run(u, aux, i, i == 2) for i, (u, aux) in enumerate(zip(commands, auxes[:3], strict=True))]
    last = Run(np.round(excitation.draw_heldout(rng, reach), 6), auxes[3], 3)
    runs = _under_conditions(runs, names, conditions, settings.excitation, reach, around)
    monitor = draw_monitor(around, reach) if conditions.monitored else None

    plain = readings(rig, Physics(), runs)
    physics, found = Physics(), []
    for name in names:
        wanted = settings.severity or math.exp(rng.uniform(*np.log(_range_of(settings.track))))
        change, label = _one_effect(name, wanted, rng, rig, runs, plain)
        found.append(label)
        physics = _with(physics, change)
    labels = _labels(settings, rig, found, physics, runs, plain, conditions)
    entropy = [settings.seed, TRACKS.index(settings.track), settings.index, 5]
    # Noise seeds of the first three recordings, of the judge's, and of a fourth.
    seeds = np.random.SeedSequence(entropy).spawn(5)
    seeds_of_runs = [seeds[run.number if run.number < 3 else 4] for run in runs]
    recordings = [
        _written(_record(rig, physics, run, s), conditions, monitor, around)
        for run, s in zip(runs, seeds_of_runs, strict=True)
    ]
    heldout = _record(rig, _knowable(physics), last, seeds[3])
    # The judge's command is what the monitor reads on average, so that its noise cannot spoil predictions.
    still = None if monitor is None else replace(monitor, noise_v=0.0)
    return Case(recordings, labels, _written(heldout, conditions, still, around))


def _under_conditions(
    runs: list[Run],
    names: Sequence[str],
    conditions: Conditions,
    kind: str,
    reach: excitation.Reach,
    rng: np.random.Generator,
) -> list[Run]:
    """Return as many runs as are recorded, each after its history, and with or without holds."""
    if conditions.recordings > len(runs):
        aux = None if runs[0].aux is None else np.round(excitation.draw_aux(rng, reach), 6)
        fourth = np.round(excitation.draw_fourth(kind, rng, reach), 6)
        runs = [*runs, Run(fourth, aux, 4)]
    elif conditions.recordings < len(runs):
        chosen = set(rng.choice(len(runs), conditions.recordings, replace=False).tolist())
        if "load_change" in names:  # it is present only in the third
            chosen = {*sorted(chosen)[: conditions.recordings - 1], 2}
        runs = [run for run in runs if run.number in chosen]
    out = []
    for run in runs:
        u = run.u if conditions.holds else np.round(without_holds(run.u, reach, rng), 6)
        history = np.round(draw_history(rng, reach, float(u[0])), 6) if conditions.remanent else np.zeros(0)
        aux = None if run.aux is None else np.concatenate([np.zeros(history.size), run.aux])
        out.append(replace(run, u=np.concatenate([history, u]), aux=aux, history=history.size))
    return out


def _written(
    columns: dict[str, Array], conditions: Conditions, monitor: Monitor | None, rng: np.random.Generator
) -> dict[str, Array]:
    """Return the columns as the files have them: with the monitored voltage, and in the files' units."""
    u = columns["input_v"]
    if monitor is not None:
        u = (1 + monitor.gain) * u + monitor.offset_v + monitor.noise_v * rng.standard_normal(u.size)
    factors = {"output_um": conditions.scale_um, "aux_v": conditions.scale_v}
    scaled = {name: column * factors.get(name, 1.0) for name, column in columns.items()}
    return scaled | {"input_v": u * conditions.scale_v}


def _range_of(track: str) -> tuple[float, float]:
    return (2.0, 70.0) if track in ("pairs", "triples") else SEVERITIES


def _draw_rig(settings: Settings, rng: np.random.Generator) -> Rig:
    span = float(rng.choice([5.0, 7.5, 10.0, 10.0, 12.0]))
    lower = -0.2 * span if rng.random() < 0.25 else 0.0
    reach_um = float(np.exp(rng.uniform(np.log(5), np.log(100))))
    fs = float(rng.choice([2000.0, 2500.0, 4000.0, 5000.0, 8000.0, 10_000.0, 20_000.0]))
    if settings.track in ("single_other", "nulls_other"):
        family = ("preisach", "bouc_wen", "preisach", "bouc_wen", "generalised_play")[settings.index % 5]
    elif settings.track == "nulls_conditions":
        family = ("pi", "preisach", "pi", "bouc_wen", "pi", "generalised_play")[settings.index // 3 % 6]
    elif settings.track == "unknown" and settings.index % 3 == 2:
        family = str(rng.choice(["preisach", "bouc_wen"]))
    else:
        family = "pi"
    hysteresis = draw_hysteresis(family, rng, span, reach_um)
    other = draw_hysteresis(str(rng.choice(["preisach", "bouc_wen"])), rng, span, reach_um)
    colour = str(rng.choice(["white", "ar", "flicker"]))
    timing = str(rng.choice(["end_of_hold", "end_of_hold", "end_of_hold", "before_write"]))
    oversampling = int(rng.integers(6, 11))
    # A sensor of longer range is noisier: 0.5e-4 to 5e-4 of the range, within 1–10 nm.
    share = float(np.exp(rng.uniform(np.log(0.5e-4), np.log(5e-4))))
    noise_um = min(max(share * reach_um, 1e-3), 1e-2)
    if settings.track in ("single_other", "nulls_other") and colour == "white":
        colour = "ar"
    if settings.track == "crime":
        hysteresis, oversampling, colour = _commonplace(rng, span, reach_um), 3, "white"
    return Rig(
        hysteresis,
        other,
        fs,
        oversampling,
        lower,
        span,
        reach_um,
        noise_um,
        colour,
        timing if settings.timing == "mixed" else settings.timing,
        int(rng.integers(2**31)),
    )


def _commonplace(rng: np.random.Generator, span: float, reach_um: float) -> Plays:
    """Draw the plays that a tool would choose: ten, on an even grid. For the crime track only."""
    r = np.linspace(0.0, 0.45, 10) * span
    weights = np.exp(-r / (0.2 * span)) * rng.uniform(0.7, 1.3, r.size)
    weights[0] *= 12
    weights *= reach_um / float(np.sum(weights * (span - r)))
    return Plays("pi", 0.0, r, r, weights, span)


def _draw_names(settings: Settings, rng: np.random.Generator) -> tuple[str, ...]:
    track = settings.track
    if track.startswith("nulls") or (track == "crime" and settings.index % 4 == 0):
        return ()
    if track == "unknown":
        return (list(UNKNOWNS)[settings.index % len(UNKNOWNS)],)
    listed = [name for name in EFFECTS if track != "single_other" or name not in STATIC]
    if track in ("single_pi", "single_other", "crime"):
        # Every name occurs once before any occurs twice; the cycle of 5 families shares no factor with 18.
        order = np.random.default_rng([settings.seed, 3]).permutation(len(listed))
        return (listed[order[settings.index % len(listed)]],)
    count = 2 if track == "pairs" else 3
    while True:
        names = tuple(str(n) for n in rng.choice(listed, count, replace=False))
        if not any(len(clash.intersection(names)) > 1 for clash in CLASHING):
            return names


def _one_effect(
    name: str, wanted: float, rng: np.random.Generator, rig: Rig, runs: Sequence[Run], plain: Array
) -> tuple[dict[str, object], dict[str, object]]:
    known = name in EFFECTS
    proposal: Proposal = (
        EFFECTS[name].propose(rng, rig, list(runs)) if known else UNKNOWNS[name].proposal(rng, rig)
    )

    def measure(strength: float) -> float:
        return severity(rig, _with(Physics(), proposal.change(strength)), runs, plain)

    strength, reached = strength_for(wanted, measure, proposal.low, proposal.high, proposal.start)
    change = proposal.change(strength)
    others = [replace(rig, timing=timing) for timing in TICKS_LATE if timing != rig.timing]
    without = {rig.timing: plain} | {one.timing: readings(one, Physics(), runs) for one in others}
    with_effect = readings(rig, _with(Physics(), change), runs)
    beyond_um = beyond_plays_um(with_effect, without, rig.timing, runs, rig.span_v)
    what = EFFECTS[name] if known else UNKNOWNS[name]
    parameters = {
        key: {"value": float(value), "unit": unit}
        for key, (value, unit) in proposal.parameters(strength).items()
    }
    if name == "delay" and rig.timing == "before_write":
        parameters["delay_s"]["or"] = parameters["delay_s"]["value"] + 1 / rig.fs_hz  # including the hold
    label = {
        "name": name,
        "listed": known,
        "form": "published",
        "block": what.block if known else what.place,
        "group": sorted(group_of(name)) if known else [],
        "near": [] if known else sorted(what.near),
        "equation": what.equation,
        "severity_wanted": wanted,
        "severity": reached,
        "severity_beyond_plays": beyond_um / rig.noise_um,
        "parameters": parameters,
    }
    if name == "hysteresis_operator":
        label["family"] = rig.other_hysteresis.family
    return change, label


def _with(physics: Physics, change: dict[str, object]) -> Physics:
    """Return the physics with these fields replaced; effects outside the list are added to those present."""
    if "outside" in change:
        change = {"outside": (*physics.outside, *change["outside"])}
    return replace(physics, **change)


def _knowable(physics: Physics) -> Physics:
    """Remove effects that no input determines, because their phase on another day cannot be predicted."""
    outside = tuple(o for o in physics.outside if o.place != "sensor" or o.name == "sensor_memory")
    return replace(physics, hum_um=(), drift_um=0.0, outside=outside)


def _record(rig: Rig, physics: Physics, run: Run, seed: np.random.SeedSequence) -> dict[str, Array]:
    u = run.u[run.history :]
    noise = draw_noise(np.random.default_rng(seed), rig.noise_colour, u.size, rig.noise_um)
    columns = {
        "time_s": np.arange(u.size) / rig.fs_hz,
        "input_v": u,
        "output_um": simulate(rig, physics, run, noise),
    }
    return columns if run.aux is None else columns | {"aux_v": run.aux[run.history :]}


def _labels(settings, rig, effects, physics, runs, plain, conditions):
    listed = [e["name"] for e in effects if e["listed"]]
    tolerated = set()
    if rig.hysteresis.family != "pi":
        tolerated |= STATIC
    if rig.timing == "before_write":
        tolerated |= {"delay"}
    for effect in effects:
        tolerated |= set(effect["near"])
    together = readings(rig, physics, runs) - plain
    for effect in effects:
        for parameter in effect["parameters"].values():
            for key in parameter.keys() - {"unit"}:
                parameter[key] = conditions.scaled(parameter[key], parameter["unit"])
    return {
        "track": settings.track,
        "seed": settings.seed,
        "index": settings.index,
        "excitation": settings.excitation,
        "adequate": settings.excitation != "poor",
        "fs_hz": rig.fs_hz,
        "oversampling": rig.oversampling,
        "timing": rig.timing,
        "family": rig.hysteresis.family,
        "conditions": asdict(conditions),
        "lower_v": conditions.scaled(rig.lower_v, "V"),
        "upper_v": conditions.scaled(rig.span_v, "V"),
        "range_um": conditions.scaled(rig.range_um, "um"),
        "noise_rms_um": conditions.scaled(rig.noise_um, "um"),
        "noise_colour": rig.noise_colour,
        "names": listed,
        "unknown": [e["name"] for e in effects if not e["listed"]],
        "tolerated": sorted(tolerated - set(listed)),
        "effects": effects,
        "severity_together": misfit_um(plain + together, plain) / rig.noise_um,
        "heldout_without": [n for n in ("hum", "thermal_drift") if n in listed],
    }
