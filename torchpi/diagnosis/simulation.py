"""A given simulation: what it makes of the recordings, and the physics that it already has."""

from collections.abc import Sequence

import numpy as np
import torch

from torchpi.diagnosis.hypothesis import Member
from torchpi.diagnosis.records import Record
from torchpi.stage import EffectSettings, Stage


def simulated(simulation: Stage, records: Sequence[Record]) -> tuple[np.ndarray, ...]:
    """Recorded less simulated, µm, for each recording, the simulation as it was given."""
    return tuple(record.y - simulated_output(simulation, record) for record in records)


def simulated_output(simulation: Stage, record: Record) -> np.ndarray:
    """What the simulation's sensor would read, without noise, (time,), µm."""
    stage = simulation.at_sample_rate(record.fs_hz)
    aux = {name: torch.from_numpy(signal)[None] for name, signal in record.aux.items()}
    with torch.no_grad():
        y, _ = stage(torch.from_numpy(record.u)[None], None, aux)
        return stage.sensor(y)[0][0].numpy()  # type: ignore[no-any-return]


def given_members(simulation: Stage | None) -> tuple[Member, ...]:
    """The effects that a simulation has: they are refitted, and not reported as missing."""
    if simulation is None:
        return ()
    return tuple(_member(one) for one in (*simulation.effects, *simulation.sensor_effects))


def _member(one: EffectSettings) -> Member:
    """Within the bounds of a fit: a mode that hardly rings is fitted as one that just does."""
    bounds = one.kind.quantities
    values = {
        name: min(max(value, bounds[name].at_least), bounds[name].at_most)
        for name, value in one.values.items()
    }
    return Member(one.kind, values, aux=one.aux)
