"""What a diagnosis says: named fields, no drawing."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from torchpi.stage import Stage

Verdict = Literal["nothing_missing", "explained", "partly_explained", "unexplained"]
PREDICTED = 2.0
"""Times what the fit to all leaves of a recording, up to which the others predict it: three quarters of a
larger squared error are extrapolation."""
Domain = Literal[
    "time", "frequency", "displacement", "rate", "direction", "since_reversal", "amplitude", "recording"
]


@dataclass(frozen=True)
class Parameter:
    """A physical parameter of a named effect, with its 90 % interval."""

    name: str
    value: float | str
    """A number; of a family of hysteresis its name."""
    unit: str
    interval_90: tuple[float, float] | None


@dataclass(frozen=True)
class Rival:
    """What was tried in place of a named effect."""

    name: str
    train_rms_um: float
    loses_nats: float
    """Log predictive density that is lost with it in place of the effect."""
    probability: float
    form: str = ""
    """Which equation of its kind, where there are several."""


@dataclass(frozen=True)
class NamedEffect:
    """A piece of physics that the simulation lacks."""

    name: str
    block: str
    alternatives: tuple[str, ...]
    """Names that these data cannot tell from it."""
    probability: float
    parameters: tuple[Parameter, ...]
    share: float
    """Of the mismatch over the floor, 0–1."""
    equation: str
    signature: str
    rivals: tuple[Rival, ...]
    """What else was tried in its place, the best first."""
    form: str = ""
    """Which equation of its kind, where there are several."""


@dataclass(frozen=True)
class OpenCause:
    """A piece of physics that the simulation may lack, too uncertain to be named."""

    name: str
    probability: float
    alternatives: tuple[str, ...]
    """Names that these data cannot tell from it."""


@dataclass(frozen=True)
class Where:
    """Where the mismatch lives: one cell of one domain."""

    domain: Domain
    range: tuple[float, float]
    unit: str
    share: float
    """Of the squared residual of the nominal stage over the floor."""
    significance: float
    """Of this cell's excess, in standard deviations of the residual's own colour."""
    label: str = ""
    """In words, where a range says little: a recording's name, a direction."""


@dataclass(frozen=True)
class Errors:
    """Of one fit, µm."""

    train_rms_um: float
    heldout_rms_um: float
    heldout_max_um: float


@dataclass(frozen=True)
class AcrossRecordings:
    """One recording, predicted with a hysteresis that was fitted to the others alone."""

    recording: str
    rms_um: float
    fitted_rms_um: float
    """With a hysteresis that was fitted to it as well."""

    @property
    def times(self) -> float:
        """The first error over the second."""
        return self.rms_um / max(self.fitted_rms_um, 1e-300)

    @property
    def predicted(self) -> bool:
        """Whether the others predict it."""
        return self.times <= PREDICTED


@dataclass(frozen=True)
class NextRecording:
    """The recording that would decide what is open."""

    why: str
    excitation: str


@dataclass(frozen=True, eq=False)
class Trace:
    """One recording, before and after."""

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
    """(time,), µm: recorded less the plain stage, refitted."""
    residual_augmented: np.ndarray
    """(time,), µm: recorded less the augmented stage."""
    signatures: dict[str, np.ndarray] = field(default_factory=dict)
    """For each named effect what it adds to the displacement, (time,), µm."""


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Where simulation and recordings differ, why, and by how much."""

    verdict: Verdict
    effects: tuple[NamedEffect, ...]
    """Strongest first."""
    open: tuple[OpenCause, ...]
    """What may be missing too, strongest first."""
    where: tuple[Where, ...]
    nominal: Errors
    """The simulation as it was given; without one, a plain stage of ten plays."""
    retuned: Errors
    """The same class of stage, refitted and grown inside itself."""
    augmented: Errors
    """With the named effects, and the unknown remainder if there is one."""
    across: tuple[AcrossRecordings, ...]
    """Each recording whose voltages the others reach, predicted by them; none where the names leave more to
    explain, or a mount sticks."""
    noise_floor_um: float | None
    """Of a reading; None where nothing in the recordings measures it."""
    heldout: str
    """How it was held out."""
    unexplained_share: float
    joint_share: float
    """What several effects explain together, and none of them beside the others."""
    next_recording: NextRecording
    next_excitation: tuple[np.ndarray, np.ndarray]
    """Its voltage, ready to play: t (time,), s, and u (time,), V."""
    says: str
    notes: tuple[str, ...]
    """What was set aside: conflicts, conventions, candidates that these recordings cannot show."""
    traces: tuple[Trace, ...]
    stage: Stage
