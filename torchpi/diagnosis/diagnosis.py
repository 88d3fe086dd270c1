"""The result of a diagnosis as named fields, without any plotting."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from torchpi.stage import Stage

Verdict = Literal["nothing_missing", "explained", "partly_explained", "unexplained"]
EXPLAINED = 1.5
"""Largest error that still counts as explained: as a multiple of the measured noise and, for a recording that
is predicted from the others, of its error in the fit to all."""
Domain = Literal[
    "time", "frequency", "displacement", "rate", "direction", "since_reversal", "amplitude", "recording"
]


@dataclass(frozen=True)
class Parameter:
    """A physical parameter of a named effect, with its 90 % interval."""

    name: str
    value: float | str
    """A number, or the name of a hysteresis family."""
    unit: str
    interval_90: tuple[float, float] | None


@dataclass(frozen=True)
class Rival:
    """An explanation that was tried in place of a named effect."""

    name: str
    train_rms_um: float
    loses_nats: float
    """Log predictive density that is lost when it replaces the effect."""
    probability: float
    form: str = ""
    """Which of the effect's equations is used, if it has several."""


@dataclass(frozen=True)
class NamedEffect:
    """A piece of physics that the simulation lacks."""

    name: str
    block: str
    alternatives: tuple[str, ...]
    """Names that these data cannot distinguish from it."""
    probability: float
    parameters: tuple[Parameter, ...]
    share: float
    """Share of the mismatch over the floor, 0–1."""
    equation: str
    signature: str
    rivals: tuple[Rival, ...]
    """Explanations that were tried in its place, the best first."""
    form: str = ""
    """Which of the effect's equations is used, if it has several."""


@dataclass(frozen=True)
class OpenCause:
    """A piece of physics that the simulation may lack, too uncertain to be named."""

    name: str
    probability: float
    alternatives: tuple[str, ...]
    """Names that these data cannot distinguish from it."""


@dataclass(frozen=True)
class Where:
    """A place where the mismatch occurs: one cell of one domain."""

    domain: Domain
    range: tuple[float, float]
    unit: str
    share: float
    """Share of the squared residual of the nominal stage over the floor."""
    significance: float
    """Significance of this cell's excess, in standard deviations for the residual's own colour."""
    label: str = ""
    """Description in words where a range says little: a recording's name, a direction."""


@dataclass(frozen=True)
class Errors:
    """The errors of one fit, µm."""

    train_rms_um: float
    heldout_rms_um: float
    heldout_max_um: float


@dataclass(frozen=True)
class AcrossRecordings:
    """One recording, predicted with a hysteresis that was fitted to the others alone."""

    recording: str
    rms_um: float
    fitted_rms_um: float
    """Error with a hysteresis that was fitted to this recording as well."""

    @property
    def times(self) -> float:
        """Ratio of `rms_um` to `fitted_rms_um`."""
        return self.rms_um / max(self.fitted_rms_um, 1e-300)

    @property
    def predicted(self) -> bool:
        """Whether the other recordings predict it."""
        return self.times <= EXPLAINED


@dataclass(frozen=True)
class NextRecording:
    """The recording that would decide the open question."""

    why: str
    excitation: str


@dataclass(frozen=True, eq=False)
class Trace:
    """One recording, with the residuals before and after the diagnosis."""

    name: str
    fs_hz: float
    t: np.ndarray
    """(time,), s."""
    u: np.ndarray
    """(time,), V."""
    y: np.ndarray
    """(time,), µm."""
    heldout: np.ndarray
    """(time,), bool."""
    residual_retuned: np.ndarray
    """(time,), µm: recorded minus the plain stage, refitted."""
    residual_augmented: np.ndarray
    """(time,), µm: recorded minus the augmented stage."""
    signatures: dict[str, np.ndarray] = field(default_factory=dict)
    """What each named effect adds to the displacement, (time,), µm."""


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Where simulation and recordings differ, why, and by how much."""

    verdict: Verdict
    effects: tuple[NamedEffect, ...]
    """Strongest first."""
    open: tuple[OpenCause, ...]
    """Effects that may also be missing, strongest first."""
    where: tuple[Where, ...]
    nominal: Errors
    """The simulation as it was given; without one, a plain stage of ten plays."""
    retuned: Errors
    """The same class of stage, refitted and enlarged within that class."""
    augmented: Errors
    """The stage with the named effects, and with the unknown remainder if there is one."""
    across: tuple[AcrossRecordings, ...]
    """Each recording whose voltages the others cover, predicted from them; empty if the names leave more to
    explain, or if a mount sticks."""
    another_motion_um: float | None
    """Rms standard deviation of the prediction of another motion by the hysteresis, which the
    recordings leave open; None unless nothing else is left to explain."""
    carries_over: bool
    """Whether the recordings determine the hysteresis for other motions, as far as that was tested."""
    noise_floor_um: float | None
    """Noise of a reading; None if nothing in the recordings measures it."""
    heldout: str
    """Which samples were held out, in words."""
    unexplained_share: float
    joint_share: float
    """Share that several effects explain jointly, and none of them given the others."""
    next_recording: NextRecording
    next_excitation: tuple[np.ndarray, np.ndarray]
    """Voltage of the next recording, ready to play: t (time,), s, and u (time,), V."""
    says: str
    notes: tuple[str, ...]
    """Remarks on what was set aside: conflicts, conventions, candidates that these recordings cannot show."""
    traces: tuple[Trace, ...]
    stage: Stage
