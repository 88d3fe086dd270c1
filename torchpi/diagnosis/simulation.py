"""A given simulation: its output for the recordings, and the physics that it already has."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import torch

from torchpi.diagnosis.hypothesis import EffectTerm
from torchpi.diagnosis.outside import Effects, Outside
from torchpi.diagnosis.posterior import Believed
from torchpi.diagnosis.records import Record
from torchpi.diagnosis.rival_models import OPERATOR_NAME
from torchpi.errors import SimulationError
from torchpi.simulators import COLUMN, Simulate, Simulator
from torchpi.stage import EffectSettings, Stage

Simulation = Stage | Simulator | Simulate | Literal["column"]
"""A stage; any function `simulate(u_v, fs_hz) -> y_um`; "column", an output stored in the recordings."""


def outside(simulation: Simulation | None) -> Outside | None:
    """Wrap a simulation that is not torchpi's own; None for a stage, or where no simulation is given.

    Raises:
        SimulationError: It is none of these, or is a stage that itself corrects a simulation.
    """
    if isinstance(simulation, Stage):
        if simulation.simulation:
            raise SimulationError(
                f"simulation: found a stage that corrects '{simulation.simulation}', expected that one itself"
            )
        return None
    if simulation is None or isinstance(simulation, Simulator):
        return Outside(simulation) if simulation else None
    if simulation == COLUMN:
        return Outside(None)
    if not callable(simulation):
        raise SimulationError(f"simulation: found {simulation!r}, expected a stage, a function or '{COLUMN}'")
    return Outside(Simulator.of(simulation))


def simulated(simulation: Stage | Outside, records: Sequence[Record]) -> tuple[np.ndarray, ...]:
    """Return recorded less simulated, µm, for each recording, with the simulation as it was given."""
    return tuple(record.y - simulated_output(simulation, record) for record in records)


def simulated_output(simulation: Stage | Outside, record: Record) -> np.ndarray:
    """Return what the simulation's sensor would read, without noise, (time,), µm."""
    if isinstance(simulation, Outside):
        return simulation.output(record, 0, record.u)
    stage = simulation.at_sample_rate(record.fs_hz)
    aux = {name: torch.from_numpy(signal)[None] for name, signal in record.aux.items()}
    with torch.no_grad():
        y, _ = stage(torch.from_numpy(record.u)[None], None, aux)
        reading_um: np.ndarray = stage.sensor(y)[0][0].numpy()
    return reading_um


def given_members(simulation: Stage | None) -> tuple[EffectTerm, ...]:
    """Return the effects that a simulation has: they are refitted, and not reported as missing."""
    if simulation is None:
        return ()
    return tuple(_member(one) for one in (*simulation.effects, *simulation.sensor_effects))


def _member(one: EffectSettings) -> EffectTerm:
    """Convert settings to a member, with values within the bounds of a fit: a mode that hardly rings is
    fitted as one that just does. Parameters at their identity are not fitted."""
    bounds = one.kind.quantities
    values = {
        name: bounds[name].nearest(value)
        for name, value in one.values.items()
        if value != one.kind.identity[name]
    }
    return EffectTerm(one.kind, values, aux=one.aux)


def with_untried(believed: Sequence[Believed], tried: Effects, untried: Effects) -> list[Believed]:
    """Add to the effects the alternatives that a simulation hides, or that could not be tried around it.

    Another hysteresis may be any untried static effect, and an effect that delays may be any untried one that
    does. Several that delay may be a single untried one and count as one, together with another hysteresis,
    since a lag before the hysteresis leaves a loop if fitted behind it. The effects declare the rest.
    """
    kinds = {effect.name: effect for effect in tried}
    slow = [effect.name for effect in untried if effect.delays]
    static = [effect.name for effect in untried if effect.time_scale == "static"]
    late = [one for one in believed if one.name in kinds and kinds[one.name].delays]
    as_one = [*late, *(one for one in believed if one.name == OPERATOR_NAME)] if slow and late else []
    found: list[Believed] = []
    for one in believed:
        if one in as_one[1:]:
            continue
        kind = kinds.get(one.name)
        more = static if kind is None else [e.name for e in untried if e.name in kind.degenerate_with]
        if kind is not None:
            more += [*(slow if kind.delays else ()), *kind.alike_inside]
        if one in as_one:
            one = replace(one, explained_um2=sum(other.explained_um2 for other in as_one))
            more += [other.name for other in as_one[1:]]
        found.append(with_alternatives(one, more))
    return found


def with_alternatives(one: Believed, more: Sequence[str]) -> Believed:
    """Add to an effect others that the data cannot distinguish from it."""
    return replace(one, alternatives=tuple(dict.fromkeys([*one.alternatives, *more])))
