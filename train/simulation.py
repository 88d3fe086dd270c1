"""Generate recordings of the simulated stage."""

import hashlib
import inspect
import math
from dataclasses import dataclass, field
from typing import Any

import torch

from torchpi.excitation.signals import EXCITATIONS, make_excitation
from torchpi.recordings.recording import Recording, check_recording
from torchpi.stage import Stage


@dataclass
class Simulated:
    """One recording of the simulated stage.

    Args:
        excitation: sine_5hz, paper_multisine (eq. 13), multisine, triangles, stairs or hold.
        duration_s: Length of the recording, s; each excitation has its own default.
        seed: Seed of the sensor noise and of random phases.
        options: Further options of the excitation.
    """

    excitation: str
    duration_s: float | None = None
    seed: int = 0
    options: dict[str, Any] = field(default_factory=dict)


@dataclass
class Simulation:
    """Recordings of a simulated stage.

    Args:
        train: Recordings to train on.
        heldout: Recordings for validation; by default, as with files, the last one of `train`.
        stage: Stage file (YAML), or the name of a built-in one: default, qin2013.
    """

    train: list[Simulated]
    heldout: list[Simulated] = field(default_factory=list)
    stage: str = "default"


def simulate(
    simulation: Simulation,
    stage: Stage | None = None,  # an identified stage, instead of the file of the simulation
) -> tuple[list[Recording], list[Recording]]:
    """Return the recordings to train on and those held out; equal settings give equal recordings.

    Raises:
        TorchpiError: The stage or an excitation is invalid.
    """
    played = stage or Stage.from_yaml(simulation.stage)
    return (
        [_record(played, simulated, stage is not None) for simulated in simulation.train],
        [_record(played, simulated, stage is not None) for simulated in simulation.heldout],
    )


def _record(stage: Stage, simulated: Simulated, identified: bool) -> Recording:
    options = (_range(stage, simulated.excitation) if identified else {}) | simulated.options
    t, u = make_excitation(
        simulated.excitation, stage.sample_rate_hz, simulated.duration_s, simulated.seed, options
    )
    with torch.no_grad():
        y_true, reading = stage.simulate(torch.from_numpy(u)[None], seed=simulated.seed)
    # Adding noise to the response of an identified stage would gain nothing.
    y = y_true if identified else reading
    name = f"{simulated.excitation}-{simulated.seed}"
    recording = Recording(
        name=name,
        t=t,
        u=u,
        y=y[0].numpy(),
        fs_hz=stage.sample_rate_hz,
        source=f"simulated {name}",
        sha256=hashlib.sha256(u.tobytes() + y.numpy().tobytes()).hexdigest(),
    )
    check_recording(recording)
    return recording


def _range(stage: Stage, excitation: str) -> dict[str, float]:
    """Return the voltage range of an identified stage as options of an excitation that takes them."""
    limits = {"low_v": stage.min_voltage_v, "high_v": stage.max_voltage_v}
    if not all(map(math.isfinite, limits.values())):
        return {}
    known = inspect.signature(EXCITATIONS[excitation]).parameters if excitation in EXCITATIONS else {}
    return limits if limits.keys() <= known.keys() else {}
