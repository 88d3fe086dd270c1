"""Training through the stage: reference motion → compensator → stage, with the error of the motion as loss.

This is direct learning: no recorded voltage is fitted, so neither the noise of a recorded displacement nor
the difference between recorded and desired motions biases the result.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor
from torch.func import functional_call

from torchpi.control.direct_inverse import DirectInverse
from torchpi.errors import ConfigError
from torchpi.excitation.signals import TRAJECTORIES
from torchpi.operators.motion import Motion, backward_motion
from torchpi.operators.reference_filter import ReferenceFilter
from torchpi.stage import Stage

from .coordinates import Coordinates


@dataclass
class Reference:
    """One motion to track.

    Args:
        trajectory: slow (eq. 15), fast (eq. 16), sine (eq. 9) or random (phases over a band).
        seed: Seed of the random phases.
        options: Further options of the trajectory, such as {high_hz: 100}.
    """

    trajectory: Literal["slow", "fast", "sine", "random"]
    seed: int = 0
    options: dict[str, Any] = field(default_factory=dict)


@dataclass
class Follow:
    """Motions to track in training through a stage, all filtered by the reference filter (eq. 14).

    Args:
        train: Motions to train on.
        heldout: Motions for validation: they stop the training and select the best epoch.
        duration_s: Duration of each motion, s.
        low: Lower end of every motion, as a share of the stroke that the recordings span.
        high: Upper end, likewise.
    """

    train: list[Reference] = field(
        default_factory=lambda: [
            Reference("slow"),
            Reference("fast"),
            *(Reference("random", seed) for seed in range(1, 5)),
        ]
    )
    heldout: list[Reference] = field(
        default_factory=lambda: [Reference("random", seed) for seed in range(11, 14)]
    )
    duration_s: float = 1.0
    low: float = 0.12
    high: float = 0.86

    def check(self) -> None:
        """Raise `ConfigError` if there is no motion to follow, or its range is empty."""
        if not 0 <= self.low < self.high <= 1:
            raise ConfigError(
                f"data.follow.low: found {self.low:g} with high {self.high:g}, expected 0 ≤ low < high ≤ 1"
            )
        for name in ("train", "heldout"):
            if not getattr(self, name):
                raise ConfigError(f"data.follow.{name}: found none, expected at least one trajectory")


@dataclass(frozen=True)
class TrackingErrors:
    """Errors of the motions; per cent refers to the largest peak to peak."""

    rms_um: float
    max_um: float
    rms_percent: float
    max_percent: float


class Tracking:
    """A stage, and motions that a compensator makes it follow.

    Args:
        stage: The stage to train through; its parameters get no gradient.
        follow: The motions.
        stroke_um: Lowest and highest displacement of the recordings.
    """

    def __init__(self, stage: Stage, follow: Follow, stroke_um: tuple[float, float]) -> None:
        self.stage = stage.requires_grad_(False)
        reach = stroke_um[1] - stroke_um[0]
        low, high = (stroke_um[0] + share * reach for share in (follow.low, follow.high))
        self.train, self.heldout = (
            torch.cat([self._motion(reference, follow.duration_s, low, high) for reference in references])
            for references in (follow.train, follow.heldout)
        )

    def coordinates(self, compensator: DirectInverse) -> Coordinates:
        """Return training coordinates; a step of length one moves the motions by their present rms error."""
        with torch.no_grad():
            motion = self._asked(compensator, self.train)
            steps_v, steps_um = (torch.diff(x).std() for x in (compensator(motion), self.train))
            rms_um = self.loss(compensator, {}).sqrt()
        return Coordinates(compensator, motion, float(rms_um * steps_v / steps_um))

    def loss(self, compensator: DirectInverse, parameters: dict[str, Tensor]) -> Tensor:
        """Return the mean squared error of the training motions, µm², for a compensator with `parameters`."""
        return self._missed(compensator, self.train, parameters).square().mean()

    def errors(self, compensator: DirectInverse) -> dict[str, TrackingErrors]:
        """Return the errors of the training and of the held-out motions."""
        found = {}
        for name, yd in (("train", self.train), ("heldout", self.heldout)):
            with torch.no_grad():
                missed = self._missed(compensator, yd, {})
            span = float((yd.amax(1) - yd.amin(1)).max())
            rms_um, max_um = float(missed.square().mean().sqrt()), float(missed.abs().max())
            found[name] = TrackingErrors(rms_um, max_um, 100 * rms_um / span, 100 * max_um / span)
        return found

    def _missed(
        self,
        compensator: DirectInverse,
        yd: Tensor,  # (motions, time), µm
        parameters: dict[str, Tensor],
    ) -> Tensor:  # (motions, time), µm
        """Return y - y_d, each motion starting from the de-energised state."""
        u = functional_call(compensator, parameters, (self._asked(compensator, yd),))
        at_rest = {name: torch.zeros_like(u) for name in self.stage.aux_names}
        y: Tensor = self.stage(u, None, at_rest)[0]
        return y - yd

    def _asked(self, compensator: DirectInverse, yd: Tensor) -> Motion:
        """Form the motions as the deployed compensator does; the last value is held past the end."""
        last = yd[:, -1:].expand(-1, compensator.preview)
        ahead = torch.cat([yd, last], 1)[:, compensator.preview :]
        return backward_motion(ahead, compensator.sample_period_s)

    def _motion(self, reference: Reference, duration_s: float, low: float, high: float) -> Tensor:
        """Return the filtered motion of a reference, (1, time), µm."""
        make = TRAJECTORIES[reference.trajectory]
        random: dict[str, Any] = {"seed": reference.seed} if reference.trajectory == "random" else {}
        try:
            _, x = make(duration_s, self.stage.sample_rate_hz, **random, **reference.options)
        except TypeError as error:
            raise ConfigError(
                f"data.follow: {reference.trajectory} cannot use its options: {error}"
            ) from None
        yr = torch.from_numpy(low + (high - low) * (x - x.min()) / np.ptp(x))[None]
        return ReferenceFilter(self.stage.sample_period_s)(yr).yd


def tracking_notes(metrics: Mapping[str, Any]) -> tuple[str, ...]:
    """Describe the tracking errors of `metrics.json` in a sentence, if there are any."""
    if "tracking" not in metrics:
        return ()
    rows = [
        f"{1e3 * metrics['tracking'][key]['rms_um']:.3g} nm rms {label}"
        for key, label in TRACKING.items()
        if key in metrics["tracking"]
    ]
    return (f"Tracking error of the held-out motions on the stage: {', '.join(rows)}.",)


TRACKING = {
    "plain": "as identified on the hysteresis without the effects",
    "before": "as identified on the stage",
    "after": "as trained through it",
}
