"""A given simulation: what it says of the recordings, and the physics that it already has."""

from collections.abc import Sequence

import numpy as np
import torch

from torchpi.diagnosis.hypothesis import Member
from torchpi.diagnosis.records import Record
from torchpi.stage import Stage
from torchpi.stage.effects.actuator.creep import Creep
from torchpi.stage.effects.actuator.input_nonlinearity import InputNonlinearity
from torchpi.stage.effects.amplifier.amplifier_lag import AmplifierLag
from torchpi.stage.effects.amplifier.delay import Delay
from torchpi.stage.effects.mechanics.resonance import Resonance
from torchpi.stage.effects.sensor.sensor_lag import SensorLag


def simulated(simulation: Stage, records: Sequence[Record]) -> tuple[np.ndarray, ...]:
    """Recorded less simulated, µm, for each recording, the simulation as it was given."""
    return tuple(record.y - simulated_output(simulation, record) for record in records)


def simulated_output(simulation: Stage, record: Record) -> np.ndarray:
    """What the simulation's sensor would read, without noise, (time,), µm."""
    stage = simulation.at_sample_rate(record.fs_hz)
    with torch.no_grad():
        y, _ = stage(torch.from_numpy(record.u)[None])
        return stage.sensor(y)[0][0].numpy()  # type: ignore[no-any-return]


def given_members(simulation: Stage | None) -> tuple[Member, ...]:
    """The effects that a simulation has: they are refitted, and not reported as missing.

    Limits of its voltage are not among them: they stand for the converter's range.
    """
    if simulation is None:
        return ()
    members = []
    amplifier, actuator = simulation.amplifier, simulation.actuator
    if amplifier.lag.cutoff_hz is not None:
        members.append(Member(AmplifierLag, {"cutoff_hz": amplifier.lag.cutoff_hz.item()}))
    if amplifier.lag.delay_s.item() > 0:
        members.append(Member(Delay, {"delay_s": amplifier.lag.delay_s.item()}))
    if actuator.curvature is not None and len(actuator.curvature.c) > 1:
        c = actuator.curvature.c
        bent = {"c2_per_v": (c[1] / c[0]).item()}
        if len(c) > 2:
            bent["c3_per_v2"] = (c[2] / c[0]).item()
        members.append(Member(InputNonlinearity, {n: v for n, v in bent.items() if v != 0}))
    if actuator.creep is not None:
        members.append(Member(Creep, {"per_decade": actuator.creep.per_decade.item()}))
    mode = simulation.mechanics.mode
    if mode is not None:
        # A mode that hardly rings is fitted as one that just does.
        most = Resonance.quantities["damping_ratio"].at_most
        damping = min(mode.damping_ratio.item(), most)
        values = {"frequency_hz": mode.frequency_hz.item(), "damping_ratio": damping}
        members.append(Member(Resonance, values))
    if simulation.sensor.lag is not None:
        members.append(Member(SensorLag, {"cutoff_hz": simulation.sensor.lag.cutoff_hz.item()}))
    return tuple(member for member in members if member.shared)
