"""Results of a commissioning, as named fields and as JSON."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from torchpi.control.direct_inverse import DirectInverse
from torchpi.diagnosis.forward_stage import ForwardStage
from torchpi.identification import InverseErrors
from torchpi.identification.selection import Step
from torchpi.loop.result import COMPENSATED, LoopResult, as_json
from torchpi.recordings.recording import Recording
from torchpi.stage import Stage
from torchpi.stage.identified import Identified


@dataclass(frozen=True, eq=False)
class Outcome:
    """A compensator and a stage from the same recordings, and a test of the compensator on the stage."""

    train: Sequence[Recording]
    heldout: Recording
    compensator: DirectInverse
    form: Sequence[Step]
    """How the form of the compensator was selected, with cross-validated errors."""
    errors: InverseErrors
    """Errors of the voltage on the held-out recording, offline."""
    forward: ForwardStage
    loop: LoopResult
    """The held-out recording's motion, followed on the identified stage."""
    looped_s: float
    """Duration of the followed part of that motion, from its beginning."""

    @property
    def stage(self) -> Stage:
        return self.forward.stage

    @property
    def identified(self) -> Identified:
        """Origin of the stage, and its own error."""
        assert self.stage.identified is not None
        return self.stage.identified

    @property
    def without_um(self) -> float:
        """Rms tracking error without compensation, µm."""
        return self.loop.without.on_true.whole.rms_um

    @property
    def with_um(self) -> float:
        """Rms tracking error with compensation, µm."""
        return self.loop.compensated.on_true.whole.rms_um

    @property
    def times_better(self) -> float:
        return self.loop.improvement[COMPENSATED].whole_rms

    @property
    def trusted(self) -> bool:
        """Whether the stage's own error is no larger than the tracking error simulated on it."""
        return self.identified.heldout_rms_um <= self.with_um

    def as_json(self) -> dict[str, Any]:
        """Return the results under plain keys with units."""
        return {
            "version": 1,
            "tracking": {
                "where": "simulated on the stage identified from the recordings",
                "motion": self.heldout.source,
                "duration_s": self.looped_s,
                "without_rms_um": self.without_um,
                "with_rms_um": self.with_um,
                "stage_heldout_rms_um": self.identified.heldout_rms_um,
            },
            "recordings": {
                "train": [recording.source for recording in self.train],
                "heldout": self.heldout.source,
                "sha256": self.identified.recordings_sha256,
            },
            "inverse": {
                "form": [{"form": str(step.form), "rms_v": step.rms_v} for step in self.form],
                "heldout": asdict(self.errors),
            },
            "stage": {
                **self.identified.plain(),
                "effects": {one.kind.name: one.values for one in self.stage.effects},
                "noise_um": self.stage.noise_um,
                "steps": [asdict(step) for step in self.forward.steps],
            },
            "loop": as_json(self.loop),
        }
