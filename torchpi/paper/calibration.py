"""How hard a stage is to control: errors of the paper's method on it, Qin et al. (2013), Section III and IV.

The method is fitted to recordings, as on the rig: sensor readings of five periods of a 5 Hz sine (stage 1,
eq. 10) and of five periods of eq. 13 (stage 2, eq. 11, 5,000 samples, the minimum that the paper requires),
each from the de-energised state. It is then judged by three errors, which the paper gives for its rig:

    modelling error on eq. 13, past the initial loading      0.21 µm  (Fig. 10)
    tracking error on eq. 15 (slow), loading included        0.22 µm  (Fig. 12)
    tracking error on eq. 16 (fast), loading included        0.23 µm  (Fig. 12)
"""

import math
from dataclasses import dataclass

import torch

from torchpi.errors import ConfigError
from torchpi.paper import fig12
from torchpi.paper.fig10 import Fig10, fig10, identify
from torchpi.stage import Stage
from torchpi.stage.effects.actuator.input_nonlinearity import InputNonlinearity

PAPER_MAX_UM = {"model": 0.21, "slow": 0.22, "fast": 0.23}
"""Maximum errors stated in the paper, µm."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """Results of the paper's method on one stage: the identified model and the tracking."""

    model: Fig10
    panels: dict[str, fig12.Panel]  # slow, fast; tracked: paper

    @property
    def max_um(self) -> dict[str, float]:
        """The three errors, µm, under the keys of `PAPER_MAX_UM`."""
        tracked = {name: panel.tracked["paper"].error.max_um for name, panel in self.panels.items()}
        return {"model": self.model.after_loading.max_um, **tracked}


def calibrate_paper_method(
    stage: Stage,
    seed: int | None = None,  # of the noise; by default that of the stage
) -> Calibration:
    """Record the stage, fit the paper's compensator to the recordings, and let it drive the stage.

    Raises:
        RecordingError, StageError: The stage cannot be recorded or driven in this way.
    """
    identified = identify(stage, seed)
    compensator = {"paper": identified.compensator.stream()}
    panels = {name: fig12.panel(stage, name, compensator) for name in fig12.TRAJECTORIES}
    return Calibration(fig10(identified), panels)


PARTS = ("noise", "quantisation", "delay", "lag", "mode", "creep", "curvature", "hysteresis")
"""Parts of the physics that `without` can remove."""
EFFECTS_OF = {
    "delay": ("delay",),
    "lag": ("amplifier_lag", "sensor_lag"),
    "mode": ("resonance",),
    "creep": ("creep",),
    "curvature": ("input_nonlinearity",),
}
"""Names of the effects that make up a part of the physics."""


def without(stage: Stage, part: str) -> Stage:
    """Return the stage with one of `PARTS` made ideal and its travel unchanged.

    "lag" is that of the amplifier and of the sensor. Curvature is replaced by a straight line through the
    same end point, hysteresis by a plain gain with the same displacement after the first rise.

    Shares of parts do not add up: maxima fall on different samples, and the fit compensates what it can.

    Raises:
        ConfigError: The part is unknown.
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
        # The straight line is a gain on the voltage, which thresholds and weights absorb.
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
    """Return the voltage that the plays receive at rest for the command `v`."""
    bent = torch.tensor([[v]], dtype=torch.float64)
    for effect in stage.before:
        if isinstance(effect, InputNonlinearity):
            bent, _ = effect(bent)
    return float(bent)
