"""A simulation that is not torchpi's: what can be tried around it, and what cannot be decided then."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from torchpi.diagnosis.records import Record
from torchpi.errors import RecordingError
from torchpi.recordings.options import SIMULATED_COLUMN
from torchpi.simulators import COLUMN, Simulator
from torchpi.stage.effects.effect import Described, Effect
from torchpi.stage.effects.inside import InsideEffect

Effects = Sequence[type[Effect] | type[InsideEffect]]


@dataclass(frozen=True, eq=False)
class Outside:
    """A simulation that is called with what drives it, or whose output stands in the recordings."""

    simulator: Simulator | None
    """None where its output is recorded."""

    @property
    def reference(self) -> str:
        """As `stage.pt` names it."""
        return self.simulator.reference if self.simulator else COLUMN

    @property
    def token(self) -> str:
        """What tells it from another, in any process."""
        return self.simulator.token if self.simulator else COLUMN

    @property
    def alignments(self) -> tuple[int, ...]:
        """By how many samples it may be late: many a discrete simulation answers a sample later than the
        recordings' convention has it."""
        return (-1, 0, 1)

    def output(self, record: Record, before: int, v: np.ndarray) -> np.ndarray:
        """(time,), µm, of one recording, for what drives it, (time,), V; where it is recorded, of so
        many ticks before."""
        return self.simulator(v, record.fs_hz) if self.simulator else record.simulated[before]

    def precedes(self, effect: type[Described]) -> bool:
        """Whether an effect acts on what drives the simulation."""
        return effect.before_hysteresis and not effect.commutes

    def can_try(self, effect: type[Described]) -> bool:
        """Whether an effect can act before or behind the simulation, as far as it is known."""
        if self.simulator:
            return not issubclass(effect, InsideEffect)
        return not self.precedes(effect)

    @property
    def travels(self) -> bool:
        """Whether another process can try it too."""
        return self.simulator is None or self.simulator.travels

    def check(self, records: Sequence[Record]) -> None:
        """Raise `TorchpiError` for an output that is missing or not finite, or that does not come again."""
        if self.simulator:
            shortest = min(records, key=lambda record: len(record.u))
            self.simulator.check_repeatable(shortest.u, shortest.fs_hz)
            return
        for record in records:
            if not record.simulated:
                raise RecordingError(
                    f"{record.name}: found no simulated output, expected a column {SIMULATED_COLUMN}"
                )
            y = record.simulated[0]
            if not np.isfinite(y).all():
                sample = int(np.flatnonzero(~np.isfinite(y))[0])
                raise RecordingError(
                    f"{record.name}: {SIMULATED_COLUMN}: found {y[sample]} at sample "
                    f"{sample}, expected finite numbers"
                )


def untried_note(simulation: Outside | None, untried: Effects) -> tuple[str, ...]:
    """Which effects cannot be tried around a simulation, and what would decide."""
    names = ", ".join(effect.name for effect in untried)
    if simulation is None or not names:
        return ()
    if simulation.simulator:
        return (
            f"Not tried: {names}: they act inside the hysteresis of the simulation, which is only called; a "
            "stage file would decide.",
        )
    return (
        f"Not tried: {names}: they act before the simulation, whose output alone is known; a simulation that "
        "can be called would decide.",
    )
