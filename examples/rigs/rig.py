"""A rig is what plays a voltage and measures the displacement: one method, at one sample rate.

To use it, copy this file and that of your hardware next to your program or notebook:

    from ni_daqmx import NiDaqmx
    from rig import record, scan
"""

import importlib
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Protocol

import numpy as np
import numpy.typing as npt

from torchpi import Compensator, Recording
from torchpi.errors import ConfigError, RecordingError

Signal = npt.NDArray[np.float64]  # shape: (time,)
SWEEP_S = 0.2
"""Of a sweep to the extremes and back to 0 V before each run, so that all begin in the same state: hysteresis
has a return-point memory, and forgets what was before."""
REST_S = 0.05
"""At 0 V after it: where the displacement counts from."""


class Rig(Protocol):
    """Hardware that moves one axis.

    Attributes:
        fs_hz: Sample rate of the voltage and of the displacement.
        min_voltage_v, max_voltage_v: What may be played; 0 V, the de-energised stage, lies between them.
    """

    fs_hz: float
    min_voltage_v: float
    max_voltage_v: float

    def play(self, u_v: Signal) -> Signal:
        """Put out a voltage, one sample a period, and return the displacement, µm, measured beside each.

        The last voltage stays. The zero of the displacement is the sensor's own.
        """
        ...


@dataclass(frozen=True, eq=False)
class Scan:
    """A motion that a rig made with a compensator.

    Attributes:
        reference_um: Where the stage should have been, (time,).
        u_v: The voltage played.
        y_um: Where the sensor saw it.
    """

    reference_um: Signal
    u_v: Signal
    y_um: Signal

    @property
    def error_um(self) -> Signal:
        """(time,), µm: measured less desired displacement."""
        return self.y_um - self.reference_um

    @property
    def rms_um(self) -> float:
        """Of the error."""
        return float(np.sqrt(np.mean(self.error_um**2)))


def record(rig: Rig, u_v: npt.ArrayLike, name: str = "rig") -> Recording:
    """Play a voltage behind a sweep to its extremes, and keep what the stage did.

    The first `SWEEP_S` of the recording set the state: fit with `skip_s=SWEEP_S`.

    Raises:
        ConfigError: A voltage that is not one signal, not finite, or outside the rig's limits.
        RecordingError: A displacement that no model can be made from.
    """
    u = swept(check_voltage(rig, np.asarray(u_v, dtype=np.float64)), rig.fs_hz)
    return Recording.from_arrays(None, u, displacement(rig, u), fs_hz=rig.fs_hz, name=name)


def scan(rig: Rig, compensator: Compensator, reference_um: npt.ArrayLike) -> Scan:
    """Follow a reference trajectory, behind a sweep to its extremes, with the compensator's voltage.

    Raises:
        ConfigError: A compensator of another sample rate, or a voltage outside the rig's limits.
        RecordingError: A reference that is not one finite signal.
    """
    if not math.isclose(compensator.sample_rate_hz, rig.fs_hz, rel_tol=1e-6):
        raise ConfigError(
            f"compensator: found {compensator.sample_rate_hz:g} Hz, expected the rig's {rig.fs_hz:g} Hz"
        )
    reference = np.asarray(reference_um, dtype=np.float64)
    u = compensator.predict(swept(reference, rig.fs_hz))
    y = displacement(rig, check_voltage(rig, u))
    return Scan(reference, u[-len(reference) :], y[-len(reference) :])


def swept(signal: Signal, fs_hz: float) -> Signal:
    """A signal behind a sweep from 0 to its extremes and back."""
    samples = max(2, round(SWEEP_S * fs_hz))
    phase = np.arange(samples) / samples
    once, twice = np.sin(np.pi * phase) ** 2, np.sin(2 * np.pi * phase) ** 2
    low, high = min(0.0, signal.min()), max(0.0, signal.max())
    if low == 0 or high == 0:
        return np.concatenate([(low + high) * once, signal])
    return np.concatenate([np.where(phase < 0.5, high, low) * twice, signal])


def check_voltage(rig: Rig, u_v: Signal) -> Signal:
    """The same voltage, if it may be played."""
    if u_v.ndim != 1 or not len(u_v):
        raise ConfigError(f"voltage: found the shape {u_v.shape}, expected (time,)")
    allowed = (rig.min_voltage_v <= u_v) & (u_v <= rig.max_voltage_v)  # False for NaN
    if not allowed.all():
        k = int(np.argmin(allowed))
        raise ConfigError(
            f"voltage, index {k}: found {u_v[k]:g} V, "
            f"expected {rig.min_voltage_v:g} to {rig.max_voltage_v:g} V; nothing was played"
        )
    return u_v


def displacement(rig: Rig, u_v: Signal) -> Signal:
    """What the stage does, (time,), µm, counted from where it rests at 0 V after a sweep."""
    rest = max(2, round(REST_S * rig.fs_hz))
    played = np.concatenate([swept(u_v, rig.fs_hz)[: -len(u_v)], np.zeros(rest), u_v])
    y = rig.play(played)
    if y.shape != played.shape:
        raise RecordingError(f"rig: found {y.size} samples of displacement, expected {len(played)}")
    settled = y[: -len(u_v)][-(rest // 2) :]
    return y[-len(u_v) :] - settled.mean()


def paced(exchange: Callable[[float], float], u_v: Signal, fs_hz: float) -> Signal:
    """Exchange a voltage for a displacement each sample period, by this computer's clock.

    Raises:
        RecordingError: An exchange that began later than the next one was due.
    """
    y, started = np.empty(len(u_v)), time.perf_counter()
    for k, voltage in enumerate(u_v.tolist()):
        wait_s = started + k / fs_hz - time.perf_counter()
        if wait_s > 0:
            time.sleep(wait_s)
        elif wait_s < -1 / fs_hz:
            raise RecordingError(
                f"rig, index {k}: found it {-1e3 * wait_s:.3g} ms late, expected less than the period, "
                f"{1e3 / fs_hz:.3g} ms; lower fs_hz"
            )
        y[k] = exchange(voltage)
    return y


def library(module: str, package: str) -> ModuleType:
    """The vendor's library, imported where it is needed.

    Raises:
        ConfigError: It is not installed; names the command.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ConfigError(f"this rig needs {module}; run: pip install {package}") from error
