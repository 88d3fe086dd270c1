"""Physics of a rig beyond its hysteresis. With the defaults nothing is added: they are a plain plant."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Mode:
    """One resonance: its frequency, damping ratio, and the share of the displacement that goes through it."""

    frequency_hz: float
    damping_ratio: float
    share: float = 1.0


@dataclass(frozen=True)
class Creep:
    """Poles in parallel with the displacement: gains (dimensionless) and time constants, s."""

    gains: tuple[float, ...]
    taus_s: tuple[float, ...]


@dataclass(frozen=True)
class Outside:
    """Physics outside the list of effects: where it acts and what it does there.

    `act(x, dt_s, seed)` takes and returns an array: the commands ("converter"), the displacement on the fine
    grid ("mechanics"), or the readings ("sensor").
    """

    name: str
    place: str
    act: Callable[[Array, float, int], Array]


@dataclass(frozen=True)
class Physics:
    """The parameters of every block, in the order of the chain."""

    delay_s: float = 0.0
    upper_v: float = float("inf")
    lower_v: float = float("-inf")
    amplifier_cutoff_hz: float = float("inf")
    slew_v_per_s: float = float("inf")
    c2_per_v: float = 0.0
    c3_per_v2: float = 0.0
    envelope: float = 0.0  # of the rising branch, in units of the span
    incongruence: float = 0.0  # share by which the loop is wider at full bias than at none
    other_family_share: float = 0.0
    rate_widening: float = 0.0  # growth of the loop for each factor e of rate
    rate_reference_v_per_s: float = 1.0
    leakage_hz: float = 0.0
    creep: Creep | None = None
    modes: tuple[Mode, ...] = ()
    load_ratio: float = 0.0  # k_S/k_A, in the loaded recording only
    coupling_um_per_v: float = 0.0
    half_gap_um: float = 0.0
    breakaway_um: float = 0.0
    sliding_share: float = 0.0
    ageing_per_s: float = 0.0
    ageing_per_um: float = 0.0
    sensor_cutoff_hz: float = float("inf")
    a2_per_um: float = 0.0
    a3_per_um2: float = 0.0
    drift_um: float = 0.0
    drift_tau_s: float = 1.0
    hum_um: tuple[float, ...] = ()
    mains_hz: float = 50.0
    lsb_um: float = 0.0
    outside: tuple[Outside, ...] = ()
