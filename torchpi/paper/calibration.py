"""How hard a stage is: what the paper's own method makes of it, Qin et al. (2013), Section III and IV.

The method is fitted to recordings, as on the rig: sensor readings of five periods of a 5 Hz sine (stage 1,
eq. 10) and of five periods of eq. 13 (stage 2, eq. 11, 5,000 samples, the least that the paper asks for),
each from the de-energised state. It is then judged by three figures, which the paper gives for its rig:

    modelling error on eq. 13, past the initial loading      0.21 µm  (Fig. 10)
    tracking error on eq. 15 (slow), loading included        0.22 µm  (Fig. 12)
    tracking error on eq. 16 (fast), loading included        0.23 µm  (Fig. 12)
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch

from torchpi.control.direct_inverse import DirectInverse
from torchpi.errors import ConfigError
from torchpi.excitation.signals import Samples, paper_multisine, sine_5hz
from torchpi.excitation.trajectory import load_trajectory
from torchpi.identification import InversePair, TwoStageResult, fit_two_stage, inverse_pair, local_slope
from torchpi.recordings.recording import Recording
from torchpi.stage import Stage
from torchpi.stage.effects.actuator.input_nonlinearity import InputNonlinearity

THRESHOLDS = (0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 1.5, 2.0, 3.0)
"""r of the paper's compensator, in the unit of S(y)."""
DEGREE = 4
"""m, of its saturation polynomial."""
PAPER_MAX_UM = {"model": 0.21, "slow": 0.22, "fast": 0.23}
"""The paper's figures, µm."""
SINE_S, MULTISINE_S = 1.0, 0.5

Signal = npt.NDArray[np.float64]  # shape: (time,)


@dataclass(frozen=True, eq=False)
class ModelError:
    """What the fitted inverse misses on its own record of eq. 13, as in Fig. 10.

    A voltage error in µm is that error through the local slope of the measured loop: the displacement by
    which the stage would miss. The initial loading ends where the voltage first reaches its largest value:
    nothing of the de-energised start is left in the plays from there on.

    Attributes:
        max_um: Past the initial loading: the paper's 0.21 µm.
        rms_um: Likewise.
        max_v: The same error in volts.
        loading_max_um: Within the initial loading.
        loading_max_v: Likewise, in volts.
        loading_end: First sample past the initial loading.
        error_um: All of it, (time,), predicted minus recorded.
    """

    max_um: float
    rms_um: float
    max_v: float
    loading_max_um: float
    loading_max_v: float
    loading_end: int
    error_um: Signal


@dataclass(frozen=True, eq=False)
class TrackingError:
    """How the stage, driven by the compensator alone, follows a trajectory, as in Fig. 12.

    The error is y - y_d of the true displacement. The initial loading ends where y_d is first within 0.1 %
    of its largest value.

    Attributes:
        max_um: Largest error, the initial loading included: the paper's 0.22 and 0.23 µm.
        rms_um: Likewise.
        max_percent: Of the trajectory's peak to peak.
        rms_percent: Likewise.
        loading_max_um: Within the initial loading.
        steady_max_um: After it.
        mean_um: After it, with its sign: the drift.
        sensor_max_um: Largest error of the sensor's reading, for comparison.
        loading_end: First sample past the initial loading.
        yd: (time,), µm.
        y: (time,), µm.
        u: (time,), V.
    """

    max_um: float
    rms_um: float
    max_percent: float
    rms_percent: float
    loading_max_um: float
    steady_max_um: float
    mean_um: float
    sensor_max_um: float
    loading_end: int
    yd: Signal
    y: Signal
    u: Signal


@dataclass(frozen=True, eq=False)
class Calibration:
    """The paper's method on one stage, and the compensator that it found."""

    model: ModelError
    slow: TrackingError
    fast: TrackingError
    fit: TwoStageResult
    compensator: DirectInverse

    @property
    def max_um(self) -> dict[str, float]:
        """The three figures under the keys of `PAPER_MAX_UM`."""
        return {"model": self.model.max_um, "slow": self.slow.max_um, "fast": self.fast.max_um}


def calibrate_paper_method(
    stage: Stage,
    seed: int | None = None,  # of the noise; the stage's own by default
) -> Calibration:
    """Record the stage, fit the paper's compensator to the recordings, and let it drive the stage.

    Raises:
        RecordingError, StageError: A stage that cannot be recorded or driven so.
    """
    seed = stage.seed if seed is None else seed
    fs_hz = stage.sample_rate_hz
    # Neighbouring seeds: the noise of one record is not that of another.
    sine = _record(stage, "5 Hz sine", sine_5hz(SINE_S, fs_hz), 4 * seed)
    multisine = _record(stage, "eq. 13", paper_multisine(MULTISINE_S, fs_hz), 4 * seed + 1)
    compensator = DirectInverse(
        stage.sample_period_s,
        THRESHOLDS,
        DEGREE,
        rate="linear",
        range_um=float(sine.y.max()),
        rate_scale_um_s=1000.0,
    )
    pairs = [inverse_pair(sine), inverse_pair(multisine)]
    fit = fit_two_stage(compensator, pairs, several_starts=False)
    return Calibration(
        _model_error(compensator, pairs[1]),
        _tracking_error(stage, compensator, "slow", 4 * seed + 2),
        _tracking_error(stage, compensator, "fast", 4 * seed + 3),
        fit,
        compensator,
    )


PARTS = ("noise", "quantisation", "delay", "lag", "mode", "creep", "curvature", "hysteresis")
"""Of the physics, each of which `without` can take away."""


def shares(stage: Stage, seed: int | None = None, parts: Sequence[str] = PARTS) -> dict[str, Calibration]:
    """The same with one part of the physics removed at a time, under its name; "all" has every part.

    Shares do not add up: maxima fall on different samples, and the fit makes up for what it can. About 1.5 s
    each.

    Raises:
        ConfigError: An unknown part.
    """
    stages = {part: without(stage, part) for part in parts}
    return {name: calibrate_paper_method(one, seed) for name, one in {"all": stage, **stages}.items()}


EFFECTS_OF = {
    "delay": ("delay",),
    "lag": ("amplifier_lag", "sensor_lag"),
    "mode": ("resonance",),
    "creep": ("creep",),
    "curvature": ("input_nonlinearity",),
}
"""The effects that a part of the physics is."""


def without(stage: Stage, part: str) -> Stage:
    """The stage with an ideal part in the place of one of `PARTS`. Its travel stays as it is.

    "lag" is that of the amplifier and of the sensor. For curvature there stands a straight line through the
    same end point, for hysteresis a plain gain that takes the first rise as far.

    Raises:
        ConfigError: An unknown part.
    """
    if part not in PARTS:
        raise ConfigError(f"part: found {part!r}, expected one of {', '.join(PARTS)}")
    settings = stage.to_dict()
    for chain in ("effects", "sensor"):
        settings[chain] = [one for one in settings[chain] if one["name"] not in EFFECTS_OF.get(part, ())]
    hysteresis = settings["hysteresis"]
    top_v = stage.max_voltage_v if math.isfinite(stage.max_voltage_v) else 10.0
    bent_v = _bent(stage, top_v)
    if part == "noise":
        settings["noise_um"] = 0.0
    elif part == "quantisation":
        settings["command_converter"] = settings["reading_converter"] = None
    elif part == "curvature":
        # Plays of a voltage that is stretched by a gain: thresholds and weights take it.
        gain = bent_v / top_v
        hysteresis["thresholds_v"] = [r / gain for r in hysteresis["thresholds_v"]]
        hysteresis["weights"] = [*(w * gain for w in hysteresis["weights"][:-1]), hysteresis["weights"][-1]]
    elif part == "hysteresis":
        *weights, constant_um = hysteresis["weights"]
        plays = zip(hysteresis["thresholds_v"], weights, strict=True)
        risen_um = sum(w * max(bent_v - r, 0.0) for r, w in plays)
        hysteresis |= {"thresholds_v": [0.0], "weights": [risen_um / bent_v, constant_um]}
    return Stage.from_dict(settings)


def _bent(stage: Stage, v: float) -> float:
    """The voltage that the plays see of `v`, at rest."""
    bent = torch.tensor([[v]], dtype=torch.float64)
    for effect in stage.before:
        if isinstance(effect, InputNonlinearity):
            bent, _ = effect(bent)
    return float(bent)


def _record(stage: Stage, name: str, excitation: Samples, seed: int) -> Recording:
    t, u = excitation
    with torch.no_grad():
        _, reading = stage.simulate(torch.from_numpy(u)[None], seed)
    return Recording(name, t, u, reading[0].numpy(), stage.sample_rate_hz, source=name)


def _model_error(compensator: DirectInverse, pair: InversePair) -> ModelError:
    with torch.no_grad():
        volts = (compensator(pair.motion) - pair.u)[0].numpy()
    microns = volts * local_slope(pair.motion.yd[0], pair.u[0]).numpy()
    # The displacement's own largest value will not do: with creep it comes in the last period.
    top = _first_at_top(pair.u[0].numpy(), 1e-9)
    return ModelError(
        max_um=_max(microns[top:]),
        rms_um=_rms(microns[top:]),
        max_v=_max(volts[top:]),
        loading_max_um=_max(microns[:top]),
        loading_max_v=_max(volts[:top]),
        loading_end=top,
        error_um=microns,
    )


def _tracking_error(stage: Stage, compensator: DirectInverse, name: str, seed: int) -> TrackingError:
    yd = load_trajectory(name, fs_hz=stage.sample_rate_hz).yd
    with torch.no_grad():
        u = compensator.stream().block(torch.from_numpy(yd))
        y, reading = stage.simulate(u[None], seed)
    error = y[0].numpy() - yd
    top = _first_at_top(yd, 1e-3)
    return TrackingError(
        max_um=_max(error),
        rms_um=_rms(error),
        max_percent=100 * _max(error) / float(np.ptp(yd)),
        rms_percent=100 * _rms(error) / float(np.ptp(yd)),
        loading_max_um=_max(error[:top]),
        steady_max_um=_max(error[top:]),
        mean_um=float(error[top:].mean()),
        sensor_max_um=_max(reading[0].numpy() - yd),
        loading_end=top,
        yd=yd,
        y=y[0].numpy(),
        u=u.numpy(),
    )


def _first_at_top(x: Signal, within: float) -> int:
    """First sample within this share of the range of the largest."""
    return int(np.argmax(x >= x.max() - within * np.ptp(x)))


def _max(error: Signal) -> float:
    return float(np.abs(error).max())


def _rms(error: Signal) -> float:
    return float(np.sqrt(np.mean(error**2)))
